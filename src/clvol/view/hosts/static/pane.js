// -- a pane: a picture, its overlay, and its events -----------------------------------------------

const TELLS_PIXELS = "devicePixelContentBoxSize" in ResizeObserverEntry.prototype;

class Pane {
  constructor(viewer, name) {
    this.viewer = viewer;
    this.name = name;
    this.bitmap = null;
    this.latest = 0; // number of the frame that is shown
    this.touches = new Map();
    this.pinch = null;
    this.pressed = false;
    this.face = null; // the clip plane under the pointer: its axis and side
    this.canvas = make("canvas", {});
    this.overlay = make("div", { class: "clvol-overlay", "aria-hidden": "true" });
    this.element = make(
      "div",
      { class: "clvol-pane", tabindex: 0, role: "application", "data-pane": name, "aria-roledescription": "picture of a volume" },
      this.canvas,
      this.overlay,
    );
    this.wiper = new Wiper(this);
    this.readout = new Readout(this);
    this.element.append(this.readout.element, this.wiper.element);
    this.moved = oncePerFrame((event) => this.send(event));
    this.wheeled = oncePerFrame(() => this.sendWheel());
    this.wheel = null;
    this.listen();
    this.pixels = null; // of the screen: columns and rows, where the browser tells them
    this.observer = new ResizeObserver((entries) => this.resized(entries.at(-1)));
    this.observer.observe(this.element, { box: TELLS_PIXELS ? "device-pixel-content-box" : "content-box" });
    this.decorate();
  }

  close() {
    this.observer.disconnect();
    this.moved.drop();
    this.wheeled.drop();
    this.readout.close();
    this.bitmap?.close();
    this.element.remove();
  }

  /** Draws a frame, unless a newer one was faster; it is acknowledged in any case. */
  async take(frame, data) {
    try {
      const bitmap = await createImageBitmap(new Blob([data], { type: `image/${frame.format}` }));
      await new Promise((drawn) => requestAnimationFrame(drawn));
      if (frame.number < this.latest) bitmap.close();
      else {
        this.latest = frame.number;
        this.bitmap?.close();
        this.bitmap = bitmap;
        this.frame = frame;
        this.draw();
        this.viewer.panel.axes.series.shown(frame);
      }
    } catch (error) {
      this.viewer.status(`a picture could not be shown: ${error.message}`, "error");
    } finally {
      this.viewer.channel.send({ type: "ack", frame: frame.number });
    }
  }

  draw() {
    const { canvas, bitmap } = this;
    if (!bitmap || !canvas.width || !canvas.height) return;
    const context = canvas.getContext("2d");
    const scale = Math.max(canvas.width / bitmap.width, canvas.height / bitmap.height);
    const [width, height] = [bitmap.width * scale, bitmap.height * scale]; // covers the pane, even if that was just resized
    context.imageSmoothingEnabled = scale !== 1;
    context.imageSmoothingQuality = "high";
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(bitmap, (canvas.width - width) / 2, (canvas.height - height) / 2, width, height);
    if (this.name === "3d" && this.decoratedFor !== this.frame.final) this.decorate(); // it may have its own scale bar and cube
    Object.assign(this.element.dataset, { frame: this.frame.number, final: Boolean(this.frame.final) });
  }

  /** Takes the screen's pixels that the pane covers: a picture of any other size would be resampled. */
  resized(entry) {
    const [told] = entry?.devicePixelContentBoxSize ?? [];
    if (told) this.pixels = [told.inlineSize, told.blockSize];
    const ratio = window.devicePixelRatio || 1;
    const { left, top, right, bottom } = this.element.getBoundingClientRect();
    const edges = [left, top, right, bottom].map((edge) => Math.round(edge * ratio)); // as browsers round them
    const counted = [edges[2] - edges[0], edges[3] - edges[1]];
    // a pixel more or less is the browser's rounding; it leaves out the scale of a screen that its tools only emulate
    const trusted = this.pixels?.every((count, i) => Math.abs(count - counted[i]) <= 1);
    const [columns, rows] = trusted ? this.pixels : counted;
    if (!columns || !rows) return;
    if (this.canvas.width !== columns || this.canvas.height !== rows) {
      Object.assign(this.canvas, { width: columns, height: rows });
      this.draw();
    }
    this.send({ event_type: "resize", width: columns / ratio, height: rows / ratio, ratio });
  }

  send(event) {
    this.viewer.channel.send({ type: "event", event: { ...event, pane: this.name } });
  }

  place(event) {
    const box = this.element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top, modifiers: modifiersOf(event) };
  }

  // Events

  listen() {
    const on = (type, work) => this.element.addEventListener(type, work, { passive: false });
    on("pointerdown", (event) => this.down(event));
    on("pointermove", (event) => this.move(event));
    on("pointerup", (event) => this.up(event));
    on("pointercancel", (event) => this.up(event));
    on("pointerleave", () => this.leave());
    on("dblclick", (event) => this.send({ event_type: "double_click", ...this.place(event), button: buttonOf(event), buttons: [] }));
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => this.turn(event));
  }

  down(event) {
    if (event.target.closest(".clvol-grip")) return;
    event.preventDefault(); // neither select text nor scroll
    this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    if (event.pointerType === "touch") {
      this.touches.set(event.pointerId, this.place(event));
      if (this.touches.size === 2) return this.startPinch();
      if (this.touches.size > 2) return;
    }
    this.hover(this.place(event)); // fingers do not hover
    this.press(this.place(event), buttonOf(event), buttonsOf(event));
  }

  leave() {
    this.readout.at(null);
    if (!this.pressed) this.hover({});
  }

  move(event) {
    this.readout.at(this.place(event));
    if (this.touches.has(event.pointerId)) this.touches.set(event.pointerId, this.place(event));
    if (this.pinch) return this.movePinch();
    if (this.pressed) this.moved({ event_type: "pointer_move", ...this.place(event), button: 0, buttons: buttonsOf(event) });
    else this.hover(this.place(event));
  }

  /** Shows which clip plane a drag from here would move. */
  hover({ x, y }) {
    const near = (this.seen?.faces ?? []).map((face) => ({ face, far: Math.hypot(face[2] - x, face[3] - y) }));
    const { face } = near.reduce((best, one) => (one.far < best.far ? one : best), { face: null, far: GRASP });
    const found = face && [face[0], face[1]];
    if (same(found, this.face)) return;
    this.face = found;
    this.element.classList.toggle("clvol-grasp", Boolean(found));
    this.decorate();
  }

  up(event) {
    const wasTouch = this.touches.delete(event.pointerId);
    if (wasTouch) this.hover({});
    if (!this.pinch) return this.release(this.place(event), buttonOf(event), buttonsOf(event));
    if (!wasTouch) return;
    this.wheeled.flush();
    this.release(this.pinch.middle, 3);
    this.pinch = null;
    this.touches.clear();
  }

  press(place, button, buttons = [button]) {
    this.pressed = true;
    this.send({ event_type: "pointer_down", ...place, button, buttons });
  }

  release(place, button, buttons = []) {
    this.moved.flush();
    if (this.pressed) this.send({ event_type: "pointer_up", ...place, button, buttons });
    this.pressed = buttons.length > 0;
  }

  /** Two fingers: their distance zooms, or their middle pans like the middle button, whichever changes first. */
  startPinch() {
    this.moved.drop();
    const at = this.fingers();
    this.release(at.middle, 1); // ends what the first finger began
    this.pinch = { ...at, first: at, does: "" };
  }

  movePinch() {
    const [at, { first }] = [this.fingers(), this.pinch];
    if (!at) return;
    if (!this.pinch.does && Math.abs(at.distance - first.distance) > PINCHED) this.pinch.does = "zoom";
    else if (!this.pinch.does && Math.hypot(at.middle.x - first.middle.x, at.middle.y - first.middle.y) > PINCHED) {
      this.pinch.does = "pan";
      this.press(first.middle, 3);
    }
    if (this.pinch.does === "zoom") {
      this.addWheel({ ...first.middle, modifiers: ["Pinch"] }, 0, -PINCH * Math.log2(at.distance / this.pinch.distance));
      this.pinch.distance = at.distance;
    } else if (this.pinch.does === "pan") this.moved({ event_type: "pointer_move", ...at.middle, button: 0, buttons: [3] });
    this.pinch.middle = at.middle;
  }

  fingers() {
    const [a, b] = [...this.touches.values()];
    if (!b) return null;
    const middle = { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, modifiers: [] };
    return { middle, distance: Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1) };
  }

  turn(event) {
    const focused = this.element.contains(document.activeElement);
    if (this.viewer.embedded && !focused && !event.ctrlKey) return; // scrolls the notebook
    event.preventDefault();
    const unit = [1, LINE_HEIGHT, this.element.clientHeight][event.deltaMode];
    this.addWheel(this.place(event), event.deltaX * unit, event.deltaY * unit);
  }

  addWheel(place, dx, dy) {
    this.wheel = { ...place, dx: (this.wheel?.dx ?? 0) + dx, dy: (this.wheel?.dy ?? 0) + dy };
    this.wheeled();
  }

  sendWheel() {
    if (this.wheel) this.send({ event_type: "wheel", ...this.wheel });
    this.wheel = null;
  }

  // Overlay

  /** `seen`: the session's message "overlay", in CSS pixels. */
  decorate(seen = this.seen) {
    this.seen = seen;
    this.decoratedFor = this.frame?.final;
    const parts = [make("span", { class: "clvol-name" }, this.viewer.paneName(this.name))];
    if (seen) parts.push(this.drawing(seen), ...this.letters(seen), ...this.around(seen));
    this.overlay.replaceChildren(...parts.filter(Boolean));
  }

  /** A scale bar, and of the volume a cube, unless the picture has its own. */
  around({ unit_pixels: pixels, right, down }) {
    if (this.name !== "3d") return [this.scale(1 / pixels)];
    const { furniture } = this.viewer.state ?? {};
    const { space } = this.viewer.info?.volume ?? {};
    const still = this.frame?.final;
    const cube = !(still && furniture?.cube) && cubeOf(space, right, down, (normal) => this.viewer.look(normal));
    return [still && furniture?.scale_bar ? null : this.scale(1 / pixels), cube || null];
  }

  /** The crosshair, the edges of the crop box, and a dot for each plane that can be dragged here. */
  drawing({ crosshair, lines = [], box, faces = [], marks = [] }) {
    const paths = [];
    if (crosshair) {
      const [x, y] = crosshair;
      const ray = (dx, dy) => `M${x + 6 * dx} ${y + 6 * dy}L${x + FAR * dx} ${y + FAR * dy}`; // those of slices leave the middle free
      const small = `M${x - 10} ${y}h20M${x} ${y - 10}v20`;
      paths.push(make("path", { class: "clvol-crosshair", d: lines.map(([dx, dy]) => ray(dx, dy) + ray(-dx, -dy)).join("") || small }));
    }
    if (box) {
      const edges = [0, 1, 2].flatMap((axis) => box.map((_, i) => [i, i | (1 << axis)]).filter(([i, j]) => i !== j && box[i] && box[j]));
      paths.push(make("path", { class: "clvol-box", d: edges.map(([i, j]) => `M${box[i].join(" ")}L${box[j].join(" ")}`).join("") }));
      if (this.face) paths.push(this.plane(box, ...this.face));
      for (const [axis, side, x, y] of faces) {
        const held = same(this.face, [axis, side]) ? " clvol-held" : "";
        paths.push(make("circle", { class: `clvol-face${held}`, cx: x, cy: y, r: 6 }));
      }
    }
    paths.push(...drawnMarks(marks, this.viewer.panel.measures, this.element.clientWidth));
    return paths.length ? make("svg", {}, ...paths) : null;
  }

  /** A face of the crop box. */
  plane(box, axis, side) {
    const [one, other] = [0, 1, 2].filter((a) => a !== axis).map((a) => 1 << a);
    const corners = [0, one, one | other, other].map((i) => box[i | (side << axis)]);
    return make("path", { class: "clvol-plane", d: corners.every(Boolean) ? `M${corners.map((c) => c.join(" ")).join("L")}Z` : "" });
  }

  /** The patient's directions at the edges of the picture; x, y, z run left, posterior, superior. */
  letters({ right, down }) {
    if (this.viewer.info?.volume?.space !== "LPS" || (this.name === "3d" && this.viewer.state?.furniture.letters)) return [];
    const word = (v) => {
      const i = [0, 1, 2].reduce((best, k) => (Math.abs(v[k]) > Math.abs(v[best]) ? k : best), 0);
      return Math.abs(v[i]) > 0.7 * Math.hypot(...v) ? ["LR", "PA", "SI"][i][v[i] > 0 ? 0 : 1] : "";
    };
    const back = (v) => v.map((c) => -c);
    return Object.entries({ right, down, left: back(right), up: back(down) }).map(([side, v]) =>
      make("span", { class: `clvol-letter clvol-${side}` }, word(v)),
    );
  }

  /** A scale bar of 1, 2 or 5 times a power of ten, about a fifth of the pane long. */
  scale(worldPerPixel) {
    if (!(worldPerPixel > 0) || !Number.isFinite(worldPerPixel)) return null;
    const wanted = (this.element.clientWidth / 5) * worldPerPixel;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].find((n) => n * power <= wanted) * power;
    const text = make("span", { dir: "ltr" }, `${short(length)} ${this.viewer.info?.volume?.units ?? ""}`.trim());
    const bar = make("span", { class: "clvol-scale" }, text);
    bar.style.width = `${length / worldPerPixel}px`;
    return bar;
  }
}

const buttonOf = (event) => ({ 0: 1, 1: 3, 2: 2, 3: 4, 4: 5 })[event.button] ?? 0; // numbers of rendercanvas
const buttonsOf = (event) => [1, 2, 3, 4, 5].filter((_, bit) => event.buttons & (1 << bit));
const modifiersOf = (event) => ["Shift", "Control", "Alt", "Meta"].filter((_, i) => [event.shiftKey, event.ctrlKey, event.altKey, event.metaKey][i]);
