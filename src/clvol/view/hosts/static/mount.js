/** Copies a text, and whether that worked; pages without https, and some notebooks, need the old way. */
async function toClipboard(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const box = make("textarea", { class: "clvol-offscreen" });
    box.value = text;
    document.body.append(box);
    box.select();
    const copied = document.execCommand?.("copy") ?? false;
    box.remove();
    return copied;
  }
}

// -- hosts -------------------------------------------------------------------------------------------------------

/** Mounts a viewer in an element; `close` of the result removes it. */
export function mount(element, channel, options = {}) {
  return new Viewer(element, channel, options);
}

/** The page of `clvol view`: a websocket, with a JSON header before the bytes of each frame. */
export function page(element) {
  const socket = new Socket(element.dataset.socket || "ws");
  const viewer = mount(element, socket, { opens: true, onLink: (text) => new URL(text.slice(text.indexOf("#")), location.href).href });
  const address = new Address(viewer);
  const anew = renewal(viewer);
  viewer.line.parentElement.after(anew);
  socket.onopen = () => {
    anew.hidden = true;
    viewer.status("");
    for (const pane of viewer.panes.values()) pane.latest = 0;
    if (viewer.state) viewer.setAll(); // from before the connection was lost
    else address.begin();
    viewer.panel.axes.series.begin();
    viewer.panel.files.clear();
    for (const pane of viewer.panes.values()) pane.resized();
  };
  socket.onlost = (words, how) => {
    viewer.status(words, "error");
    anew.hidden = !["doubtful", "ended"].includes(how);
    if (how === "wait") element.addEventListener("pointerdown", () => socket.connect(), { once: true });
    if (how === "ended") addEventListener("focus", () => socket.connect(), { once: true }); // it may have been opened in another tab
  };
  socket.onsilent = (words, kind) => (words ? viewer.status(words, kind) : viewer.status(viewer.said.text, viewer.said.kind));
  socket.connect();
  return viewer;
}

/** The widget for notebooks (anywidget). Each place that shows it has a name and its own session. */
function render({ model, el }) {
  const client = Array.from(crypto.getRandomValues(new Uint32Array(2)), (n) => n.toString(36)).join("-");
  const channel = { send: (object) => model.send({ ...object, client }), onmessage: () => {} };
  const viewer = mount(el, channel, { embedded: true });
  const received = (message, buffers) => {
    if (message.client !== client) return;
    const [data] = buffers ?? [];
    channel.onmessage(message, data ? new Uint8Array(data.buffer ?? data, data.byteOffset ?? 0, data.byteLength) : null);
  };
  model.on("msg:custom", received);
  channel.send({ type: "open" });
  return () => {
    model.off("msg:custom", received);
    viewer.close();
    channel.send({ type: "close" });
  };
}

export default { render };

const place = document.querySelector("[data-clvol-page]");
if (place) page(place);
