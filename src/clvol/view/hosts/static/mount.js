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

const RETRY = [500, 1000, 2000, 4000]; // milliseconds before reconnecting
const IDLE = 4000; // close code of an idle page, which keeps its state
const LEFT_ALONE = [1008, 1009, 4001]; // close codes after which the page does not reconnect by itself

/** The page of `clvol view`: a websocket, with a JSON header before the bytes of each frame. */
export function page(element) {
  let socket = null;
  let header = null;
  let tries = 0;
  const channel = { send: (object) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(object)), onmessage: () => {} };
  const viewer = mount(element, channel, { onLink: (text) => new URL(text.slice(text.indexOf("#")), location.href).href });
  const address = new Address(viewer);

  const connect = () => {
    const url = new URL(element.dataset.socket || "ws", location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      tries = 0;
      header = null;
      viewer.status("");
      for (const pane of viewer.panes.values()) pane.latest = 0;
      if (viewer.state) viewer.setAll(); // from before the connection was lost
      else address.begin();
      for (const pane of viewer.panes.values()) pane.resized();
    };
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        const message = header;
        header = null;
        if (message) channel.onmessage(message, data);
        return;
      }
      const message = JSON.parse(data);
      if (message.bytes !== undefined) header = message;
      else channel.onmessage(message, null);
    };
    socket.onclose = ({ code, reason }) => {
      const wait = RETRY[Math.min(tries++, RETRY.length - 1)];
      const idle = code === IDLE;
      const final = LEFT_ALONE.includes(code);
      const next = idle ? "click to continue" : final ? "reload to continue" : `trying again in ${wait / 1000} s`;
      viewer.status(`${reason || "the connection to clvol was lost"}; ${next}`, "error");
      if (idle) element.addEventListener("pointerdown", connect, { once: true });
      else if (!final) setTimeout(connect, wait);
    };
  };
  connect();
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
