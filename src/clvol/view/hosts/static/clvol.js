/**
 * clvol's viewer in a browser: the panes with the pictures, and the panel beside them.
 *
 * One module for the page of `clvol view` and for notebooks. It shows what a session sends, and sends what a user does; it computes no
 * picture. It knows the other side only as a channel: {send(object), onmessage(object, ArrayBuffer | null)}.
 */

const PANES = { "3d": ["3d"], slice: ["z"], linked: ["z", "3d", "y", "x"] };
const PANE_NAMES = { "3d": "3-D", x: "across x", y: "across y", z: "across z" };
const PATIENT_PANES = { "3d": "3-D", x: "sagittal", y: "coronal", z: "axial" };
const LINE_HEIGHT = 16; // CSS pixels per line of a wheel
const PINCH = 60; // dy of a wheel for two fingers twice as far apart
const PINCHED = 12; // CSS pixels after which two fingers zoom or pan
const GRASP = 12; // CSS pixels around the dot of a clip plane, as in the session
const NOTHING = "\u2013";
const WAITING = "waiting for the first picture";

// -- small parts -----------------------------------------------------------------------------------------------

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** A number with four digits and no trailing zeros. */
function short(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(Number(value))) return NOTHING;
  return String(Number(Number(value).toPrecision(digits)));
}

/** An element; keys of `properties` that start with "on" are listeners, others are attributes. */
function make(tag, properties = {}, ...children) {
  const svg = ["svg", "g", "path", "line", "circle", "rect", "text", "defs", "image", "linearGradient", "stop"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function attributes(element, values) {
  for (const [key, value] of Object.entries(values)) element.setAttribute(key, value);
}

const hex = (color) => "#" + color.map((c) => Math.round(255 * clamp(c, 0, 1)).toString(16).padStart(2, "0")).join("");
const rgb = (text) => [1, 3, 5].map((at) => Math.round((parseInt(text.slice(at, at + 2), 16) / 255) * 1e4) / 1e4);

/** Linear interpolation between two colours, or points. */
const mixed = (a, b, share) => a.map((c, i) => c + (b[i] - c) * share);

let counted = 0;
const unique = (word) => `clvol-${word}-${++counted}`;

/** Calls `work` at most once per frame of the screen, with the last arguments; `flush` calls it now if it is due. */
function oncePerFrame(work) {
  let due = null;
  let handle = 0;
  const flush = () => {
    cancelAnimationFrame(handle);
    handle = 0;
    const args = due;
    due = null;
    if (args) work(...args);
  };
  const later = (...args) => {
    due = args;
    if (!handle) handle = requestAnimationFrame(flush);
  };
  later.flush = flush;
  later.drop = () => {
    cancelAnimationFrame(handle);
    handle = 0;
    due = null;
  };
  return later;
}

/** Follows a pointer that went down on `element` until it is released; `moved` and `ended` get its events. */
function drag(event, element, moved, ended = () => {}) {
  event.preventDefault();
  event.stopPropagation();
  element.setPointerCapture(event.pointerId);
  const move = (other) => other.pointerId === event.pointerId && moved(other);
  const end = (other) => {
    if (other.pointerId !== event.pointerId) return;
    for (const [type, listener] of listeners) element.removeEventListener(type, listener);
    ended(other);
  };
  const listeners = [["pointermove", move], ["pointerup", end], ["pointercancel", end]];
  for (const [type, listener] of listeners) element.addEventListener(type, listener);
}

// -- controls: {element, show(value)} --------------------------------------------------------------------------

/** A row of the panel: a label and its control. */
function row(label, control, hint) {
  return make("label", { class: "clvol-row", title: hint }, make("span", {}, label), control);
}

/** A list to choose from; `options` are texts, or [value, text]. */
function choice(label, changed, hint) {
  const list = make("select", { onchange: () => changed(list.value) });
  return {
    element: row(label, list, hint),
    list,
    fill(options) {
      list.replaceChildren(...options.map((o) => (Array.isArray(o) ? new Option(o[1], o[0]) : new Option(o, o))));
    },
    show(value) {
      const text = value === null || value === undefined ? "" : String(value);
      if (![...list.options].some((o) => o.value === text)) list.append(new Option(text || NOTHING, text));
      list.value = text;
    },
  };
}

function toggle(label, changed, hint) {
  const box = make("input", { type: "checkbox", onchange: () => changed(box.checked) });
  return {
    element: make("label", { class: "clvol-check", title: hint }, box, make("span", {}, label)),
    box,
    show(value) {
      box.checked = Boolean(value);
    },
  };
}

/**
 * A number by slider and keyboard; `changed(value, live)`, live while the slider moves. With `scale` "log" the slider stands at logarithms;
 * with `open`, an emptied box is null: the session decides.
 */
function slider(label, { low, high, step = "any", scale = "linear", open = false }, changed, hint) {
  const range = make("input", { type: "range", min: low, max: high, step, "aria-label": label });
  const number = make("input", { type: "number", step: "any", "aria-label": `${label}, as a number` });
  const [place, value] = scale === "log" ? [Math.log10, (at) => Number((10 ** at).toPrecision(2))] : [Number, Number];
  let held = false;
  let typing = false;
  const moved = oncePerFrame((to) => changed(to, true));
  range.addEventListener("pointerdown", () => (held = true));
  range.addEventListener("input", () => {
    number.value = short(value(range.value));
    moved(value(range.value));
  });
  range.addEventListener("change", () => {
    held = false;
    moved.drop();
    changed(value(range.value), false);
  });
  number.addEventListener("input", () => (typing = true));
  number.addEventListener("blur", () => (typing = false));
  number.addEventListener("change", () => {
    typing = false;
    if (number.value !== "" && Number.isFinite(Number(number.value))) changed(Number(number.value), false);
    else if (open && number.validity.valid) changed(null, false);
  });
  const control = {
    element: make("div", { class: "clvol-row clvol-slider", title: hint }, make("span", {}, label), range, number),
    range,
    /** Without `reason` it is live; else it is not, and says why. */
    unheard(reason) {
      range.disabled = number.disabled = Boolean(reason);
      control.element.title = reason || hint || "";
    },
    limit(least, most) {
      const [first, last] = [place(least), place(most)];
      const by = step === "any" ? (last - first) / 200 || 1 : step; // with "any", arrow keys step by a whole unit
      attributes(range, { min: first, max: last, step: by });
    },
    show(shown) {
      if (held || typing) return;
      const unknown = shown === null || shown === undefined;
      range.value = unknown ? (Number(range.min) + Number(range.max)) / 2 : place(shown);
      number.value = unknown ? "" : short(shown, 5);
      number.placeholder = "auto";
    },
  };
  control.limit(low, high);
  return control;
}

function colorBox(label, changed) {
  const box = make("input", { type: "color", "aria-label": label, oninput: () => changed(rgb(box.value), true) });
  box.addEventListener("change", () => changed(rgb(box.value), false));
  return { element: row(label, box), box, show: (value) => Array.isArray(value) && (box.value = hex(value)) };
}

/** A value as text: a picture is asked for when the box is left or Enter is pressed. */
function textBox(label, changed, hint, words = (value) => String(value ?? "")) {
  const box = make("input", { type: "text", "aria-label": label, title: hint, spellcheck: false, onchange: () => changed(box.value) });
  return {
    element: row(label, box),
    box,
    show(value) {
      if (document.activeElement !== box) box.value = words(value);
    },
  };
}

/** Surfaces as text, "value:color:opacity,...". */
function surfacesBox(label, changed, hint) {
  const one = ([value, color, opacity]) => `${typeof value === "number" ? short(value) : value}:${hex(color)}:${short(opacity, 3)}`;
  return textBox(label, changed, hint, (value) => (value ?? []).map(one).join(", "));
}

function button(text, pressed, { label, title, kind = "" } = {}) {
  return make("button", { type: "button", class: `clvol-button ${kind}`, "aria-label": label, title: title ?? label, onclick: pressed }, text);
}

function section(title, open, ...children) {
  return make("details", { class: "clvol-section", open }, make("summary", {}, title), make("div", { class: "clvol-body" }, ...children));
}

// -- a pane: a picture, its overlay, and its events -----------------------------------------------

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
    this.keys = new Set(); // pressed ones
    this.canvas = make("canvas", {});
    this.overlay = make("div", { class: "clvol-overlay", "aria-hidden": "true" });
    this.element = make(
      "div",
      { class: "clvol-pane", tabindex: 0, role: "application", "data-pane": name, "aria-roledescription": "picture of a volume" },
      this.canvas,
      this.overlay,
    );
    this.wiper = new Wiper(this);
    this.element.append(this.wiper.element);
    this.moved = oncePerFrame((event) => this.send(event));
    this.wheeled = oncePerFrame(() => this.sendWheel());
    this.wheel = null;
    this.listen();
    this.observer = new ResizeObserver(() => this.resized());
    this.observer.observe(this.element);
    this.decorate();
  }

  close() {
    this.observer.disconnect();
    this.moved.drop();
    this.wheeled.drop();
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
    Object.assign(this.element.dataset, { frame: this.frame.number, final: Boolean(this.frame.final) });
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== columns || this.canvas.height !== rows) {
      Object.assign(this.canvas, { width: columns, height: rows });
      this.draw();
    }
    this.send({ event_type: "resize", width, height, ratio });
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
    on("pointerleave", () => this.pressed || this.hover({}));
    on("dblclick", (event) => this.send({ event_type: "double_click", ...this.place(event), button: buttonOf(event), buttons: [] }));
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => this.turn(event));
    on("keydown", (event) => this.key(event));
    on("keyup", (event) => this.key(event));
    on("blur", () => this.releaseKeys());
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

  move(event) {
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

  /** Passes keys to the session, except those of the browser and those that leave the pane. */
  key(event) {
    if (event.target !== this.element) return;
    const down = event.type === "keydown";
    const typed = event.getModifierState("AltGraph"); // needed for brackets on some keyboards
    const command = (event.ctrlKey || event.metaKey) && !typed && !["Control", "Meta"].includes(event.key);
    if (down && event.altKey && event.key.startsWith("Arrow")) return;
    if (down && (event.key === "Tab" || /^F\d/.test(event.key) || (command && !["z", "y"].includes(event.key.toLowerCase())))) return;
    event.preventDefault();
    event.stopPropagation(); // notebooks have their own shortcuts
    if (down) this.keys.add(event.key);
    else this.keys.delete(event.key);
    this.send({ event_type: down ? "key_down" : "key_up", key: event.key, modifiers: modifiersOf(event) });
  }

  releaseKeys() {
    for (const key of this.keys) this.send({ event_type: "key_up", key, modifiers: [] });
    this.keys.clear();
  }

  // Overlay

  /** `seen`: the session's message "overlay", in CSS pixels. */
  decorate(seen = this.seen) {
    this.seen = seen;
    const parts = [make("span", { class: "clvol-name" }, this.viewer.paneName(this.name))];
    if (seen) parts.push(this.drawing(seen), ...this.letters(seen), this.name === "3d" ? null : this.scale(1 / seen.unit_pixels));
    this.overlay.replaceChildren(...parts.filter(Boolean));
  }

  /** The crosshair, the edges of the crop box, and a dot for each plane that can be dragged here. */
  drawing({ crosshair, box, faces = [] }) {
    const paths = [];
    if (crosshair) {
      const [x, y] = crosshair;
      const through = `M${x} 0V${y - 6}M${x} ${y + 6}V9999M0 ${y}H${x - 6}M${x + 6} ${y}H9999`;
      const small = `M${x - 10} ${y}h20M${x} ${y - 10}v20`;
      paths.push(make("path", { class: "clvol-crosshair", d: this.name === "3d" ? small : through }));
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
    const bar = make("span", { class: "clvol-scale" }, `${short(length)} ${this.viewer.info?.volume?.units ?? ""}`.trim());
    bar.style.width = `${length / worldPerPixel}px`;
    return bar;
  }
}

const buttonOf = (event) => ({ 0: 1, 1: 3, 2: 2, 3: 4, 4: 5 })[event.button] ?? 0; // numbers of rendercanvas
const buttonsOf = (event) => [1, 2, 3, 4, 5].filter((_, bit) => event.buttons & (1 << bit));
const modifiersOf = (event) => ["Shift", "Control", "Alt", "Meta"].filter((_, i) => [event.shiftKey, event.ctrlKey, event.altKey, event.metaKey][i]);

// -- the transfer function over the histogram -------------------------------------------------------------------

const GRAPH = { height: 132, strip: 10, bar: 24 };
const CURVE = 12; // pieces of a line between two points, which the axis of opacity bends

/** Height of an opacity, as a share: the root, because most of what is seen lies below a tenth. */
const heightOf = (opacity) => Math.sqrt(clamp(opacity, 0, 1));
const opacityOf = (height) => clamp(height, 0, 1) ** 2;

class TransferEditor {
  constructor(viewer) {
    this.viewer = viewer;
    this.points = [];
    this.selected = 0;
    this.held = false;
    this.range = [0, 1];
    this.gradient = unique("gradient");
    this.log = true;
    this.parts = {
      stops: make("linearGradient", { id: this.gradient }),
      bars: make("path", { class: "clvol-bars" }),
      area: make("path", { class: "clvol-area", fill: `url(#${this.gradient})` }),
      line: make("path", { class: "clvol-curve" }),
      strip: make("rect", { x: 0, height: GRAPH.strip, fill: `url(#${this.gradient})` }),
      isovalue: this.makeIsovalue(),
      points: make("g", {}),
      window: make("g", {}),
    };
    this.svg = make("svg", { class: "clvol-graph", role: "group", "aria-label": "histogram and transfer function" });
    this.svg.append(make("defs", {}, this.parts.stops), ...Object.values(this.parts).slice(1));
    this.svg.addEventListener("dblclick", (event) => this.addAt(event));
    this.handles = this.makeWindow();
    this.ends = [make("output", {}), make("output", {})];
    this.value = make("input", { type: "number", step: "any", "aria-label": "value of the point", onchange: () => this.typed() });
    this.opacity = make("input", { type: "number", min: 0, max: 1, step: 0.01, "aria-label": "opacity of the point", onchange: () => this.typed() });
    this.color = make("input", { type: "color", "aria-label": "colour of the point" });
    const recolored = oncePerFrame(() => this.edit(this.selected, { color: rgb(this.color.value) }, true));
    this.color.addEventListener("input", recolored);
    this.color.addEventListener("change", () => (recolored.drop(), this.edit(this.selected, { color: rgb(this.color.value) })));
    this.remove = button("Delete", () => this.deletePoint(this.selected), { label: "delete the point" });
    const add = button("Add", () => this.addAfter(this.selected), { label: "add a point after this one" });
    const scale = toggle("log", (on) => ((this.log = on), this.draw()), "logarithmic counts in the histogram");
    scale.show(true);
    this.element = make(
      "div",
      { class: "clvol-transfer" },
      this.svg,
      make("div", { class: "clvol-ends" }, this.ends[0], scale.element, this.ends[1]),
      make("div", { class: "clvol-point" }, this.color, this.value, this.opacity, add, this.remove),
    );
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.svg);
  }

  close() {
    this.observer.disconnect();
  }

  // Coordinates

  get width() {
    return Math.max(this.svg.clientWidth - 16, 50); // points at the ends are not cut off
  }

  x(value) {
    const [low, high] = this.range;
    return 8 + this.width * clamp((value - low) / (high - low || 1), 0, 1);
  }

  y(opacity) {
    return 8 + (GRAPH.height - 8) * (1 - heightOf(opacity));
  }

  at(event) {
    const box = this.svg.getBoundingClientRect();
    const [low, high] = this.range;
    const share = clamp((event.clientX - box.left - 8) / this.width, 0, 1);
    return { value: low + share * (high - low), opacity: opacityOf(1 - (event.clientY - box.top - 8) / (GRAPH.height - 8)) };
  }

  /** The interpolated [colour, opacity] at a value. */
  between(value) {
    const { points } = this;
    const after = points.findIndex((p) => p[0] > value);
    if (after === 0) return points[0].slice(1);
    if (after < 0) return points.at(-1).slice(1);
    const [a, b] = [points[after - 1], points[after]];
    const share = (value - a[0]) / (b[0] - a[0]);
    return [mixed(a[1], b[1], share), a[2] + (b[2] - a[2]) * share];
  }

  // Drawing

  show(points, isovalue) {
    this.isovalue = isovalue;
    if (this.held) return;
    this.points = points ?? [];
    this.selected = clamp(this.selected, 0, Math.max(this.points.length - 1, 0));
    this.draw();
  }

  draw() {
    const { parts, points } = this;
    const edges = this.viewer.info?.histogram?.edges ?? [0, 1];
    const values = [edges[0], edges.at(-1), ...points.map((p) => p[0])];
    if (!this.held) this.range = [Math.min(...values), Math.max(...values)];
    parts.bars.setAttribute("d", this.bars(edges, this.viewer.info?.histogram?.counts ?? []));
    attributes(parts.strip, { x: 8, y: GRAPH.height + 4, width: this.width });
    this.svg.setAttribute("height", GRAPH.height + 4 + GRAPH.strip + GRAPH.bar);
    this.ends.forEach((end, i) => (end.value = short(this.range[i])));
    const marked = this.isovalue !== null && this.isovalue !== undefined;
    parts.isovalue.style.display = marked ? "" : "none";
    if (marked) {
      parts.isovalue.setAttribute("transform", `translate(${this.x(this.isovalue).toFixed(2)} 0)`);
      const [low, high] = this.isovalues();
      attributes(this.grip, { "aria-valuemin": low, "aria-valuemax": high, "aria-valuenow": this.isovalue, "aria-valuetext": short(this.isovalue) });
    }
    if (points.length) this.drawPoints();
    for (const input of [this.value, this.opacity, this.color, this.remove]) input.disabled = !points.length;
    const chosen = points[this.selected];
    if (!chosen) return;
    if (document.activeElement !== this.value) this.value.value = short(chosen[0], 5);
    if (document.activeElement !== this.opacity) this.opacity.value = short(chosen[2], 3);
    this.color.value = hex(chosen[1]);
    this.remove.disabled = points.length < 2;
  }

  bars(edges, counts) {
    const heights = counts.map((n) => (this.log ? Math.log1p(n) : n));
    const sorted = [...heights].sort((a, b) => b - a);
    const top = (this.log ? sorted[0] : sorted[Math.min(2, sorted.length - 1)]) || 1; // the bar of the background may be cut off
    const steps = heights.map((n, i) => {
      const y = GRAPH.height - (GRAPH.height - 8) * Math.min(n / top, 1);
      return `H${this.x(edges[i]).toFixed(1)}V${y.toFixed(1)}`;
    });
    return `M8 ${GRAPH.height}${steps.join("")}H${this.x(edges.at(-1)).toFixed(1)}V${GRAPH.height}Z`;
  }

  drawPoints() {
    const { parts, points } = this;
    const [low, high] = this.range;
    parts.stops.replaceChildren(
      ...points.map((p) => make("stop", { offset: (p[0] - low) / (high - low || 1), "stop-color": hex(p[1]) })),
    );
    attributes(parts.stops, { gradientUnits: "userSpaceOnUse", x1: 8, x2: 8 + this.width, y1: 0, y2: 0 });
    const path = [[low, points[0][2]]];
    points.forEach((p, i) => {
      const [value, , opacity] = points[i - 1] ?? [low, null, p[2]];
      for (let k = 1; k <= CURVE; k++) path.push(mixed([value, opacity], [p[0], p[2]], k / CURVE));
    });
    path.push([high, points.at(-1)[2]]);
    const line = path.map(([v, a]) => `${this.x(v).toFixed(1)} ${this.y(a).toFixed(1)}`).join("L");
    parts.line.setAttribute("d", `M${line}`);
    parts.area.setAttribute("d", `M${this.x(low)} ${GRAPH.height}L${line}L${this.x(high)} ${GRAPH.height}Z`);
    while (parts.points.children.length > points.length) parts.points.lastChild.remove();
    while (parts.points.children.length < points.length) parts.points.append(this.makePoint(parts.points.children.length));
    points.forEach(([value, color, opacity], i) => {
      attributes(parts.points.children[i], {
        cx: this.x(value),
        cy: this.y(opacity),
        fill: hex(color),
        "aria-label": `point ${i + 1} of ${points.length}`,
        "aria-valuenow": value,
        "aria-valuemin": low,
        "aria-valuemax": high,
        "aria-valuetext": `value ${short(value)}, opacity ${short(opacity, 3)}, colour ${hex(color)}`,
        "aria-current": i === this.selected,
      });
    });
    const ends = this.clim();
    this.handles.forEach((handle, i) => {
      const share = [0, 1, 0.5][i];
      attributes(handle, { x: this.x(ends[0] + (ends[1] - ends[0]) * share) - (i < 2 ? 5 : 9), "aria-valuenow": ends[i] ?? (ends[0] + ends[1]) / 2 });
    });
    attributes(this.span, { x: this.x(ends[0]), width: Math.max(this.x(ends[1]) - this.x(ends[0]), 0) });
  }

  // Points

  makePoint(index) {
    const point = make("circle", { class: "clvol-dot", r: 6, tabindex: 0, role: "slider" });
    point.addEventListener("focus", () => this.select(index));
    point.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.held = true;
      point.focus({ preventScroll: true });
      const moved = oncePerFrame((at) => this.edit(index, at, true));
      drag(event, point, (other) => moved(this.at(other)), () => {
        moved.flush();
        this.held = false;
        this.viewer.settle();
      });
    });
    point.addEventListener("dblclick", (event) => {
      event.stopPropagation();
      this.color.click();
    });
    point.addEventListener("contextmenu", (event) => {
      event.preventDefault();
      this.deletePoint(index);
    });
    point.addEventListener("keydown", (event) => this.keyOnPoint(event, index));
    return point;
  }

  keyOnPoint(event, index) {
    const [value, , opacity] = this.points[index];
    const by = event.shiftKey ? 5 : 1;
    const wide = ((this.range[1] - this.range[0]) / 200) * by;
    const moves = {
      ArrowLeft: { value: value - wide },
      ArrowRight: { value: value + wide },
      ArrowUp: { opacity: opacityOf(heightOf(opacity) + 0.02 * by) },
      ArrowDown: { opacity: opacityOf(heightOf(opacity) - 0.02 * by) },
    };
    if (moves[event.key]) this.edit(index, moves[event.key]);
    else if (event.key === "Delete" || event.key === "Backspace") this.deletePoint(index);
    else if (event.key === "Enter" || event.key === " ") this.color.focus();
    else if (event.key === "Insert" || event.key === "+") this.addAfter(index);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  select(index) {
    this.selected = index;
    this.draw();
  }

  /** Moves or recolours a point, between its neighbours. */
  edit(index, { value, opacity, color }, live = false) {
    const points = this.points.map((p) => [...p]);
    if (!points[index]) return;
    const [low, high] = [points[index - 1]?.[0] ?? -Infinity, points[index + 1]?.[0] ?? Infinity];
    if (value !== undefined) points[index][0] = clamp(value, low, high);
    if (opacity !== undefined) points[index][2] = clamp(opacity, 0, 1);
    if (color !== undefined) points[index][1] = color;
    this.put(points, index, live);
  }

  typed() {
    const [value, opacity] = [this.value, this.opacity].map((input) => (input.value === "" ? undefined : Number(input.value)));
    this.edit(this.selected, { value, opacity });
  }

  addAt(event) {
    if (!this.points.length) return;
    const { value, opacity } = this.at(event);
    this.insert(value, opacity);
  }

  /** Adds a point midway between this and the next. */
  addAfter(index) {
    const [a, b] = this.points[index + 1] ? [this.points[index], this.points[index + 1]] : [this.points[index], [this.range[1]]];
    if (a) this.insert((a[0] + b[0]) / 2);
  }

  insert(value, opacity) {
    const [color, there] = this.between(value);
    const after = this.points.findIndex((p) => p[0] > value);
    const index = after < 0 ? this.points.length : after;
    this.put([...this.points.slice(0, index), [value, color, opacity ?? there], ...this.points.slice(index)], index);
    this.parts.points.children[index]?.focus();
  }

  deletePoint(index) {
    if (this.points.length < 2) return;
    this.put(this.points.filter((_, i) => i !== index), Math.max(index - 1, 0));
    this.parts.points.children[this.selected]?.focus();
  }

  put(points, selected = this.selected, live = false) {
    this.points = points;
    this.selected = selected;
    this.draw();
    const own = this.viewer.state.transfer;
    const { unit_distance: unit } = own ?? this.viewer.effective.transfer ?? {}; // the length that opacities refer to
    const changes = own?.points || !own ? { "transfer.points": points, ...(unit ? { "transfer.unit_distance": unit } : {}) } : null;
    this.viewer.set(changes ?? { transfer: { points, unit_distance: unit ?? null } }, live); // in place of one by the gradient too
  }

  // The isovalue: a line with a handle at its top

  makeIsovalue() {
    this.grip = make("path", { class: "clvol-handle", d: "M-7 0H7V9L0 16L-7 9Z", tabindex: 0, role: "slider", "aria-label": "isovalue in the histogram" });
    const line = make("line", { class: "clvol-isovalue", y1: 0, y2: GRAPH.height });
    const wide = make("rect", { class: "clvol-beside", x: -6, width: 12, height: GRAPH.height });
    for (const part of [this.grip, wide]) part.addEventListener("pointerdown", (event) => this.dragIsovalue(event, part));
    this.grip.addEventListener("keydown", (event) => this.keyOnIsovalue(event));
    return make("g", {}, line, wide, this.grip);
  }

  /** The range of values. */
  isovalues() {
    const edges = this.viewer.info?.histogram?.edges ?? this.range;
    return [edges[0], edges.at(-1)];
  }

  dragIsovalue(event, part) {
    if (event.button !== 0) return;
    this.held = true;
    this.grip.focus({ preventScroll: true });
    const aside = this.at(event).value - this.isovalue; // so that it does not jump to the pointer
    const moved = oncePerFrame((value) => this.moveIsovalue(value, true));
    drag(event, part, (other) => moved(this.at(other).value - aside), () => {
      moved.flush();
      this.held = false;
      this.viewer.settle();
    });
  }

  keyOnIsovalue(event) {
    const [low, high] = this.isovalues();
    const by = ((high - low) / 200) * (event.shiftKey ? 5 : 1);
    const [less, more] = [this.isovalue - by, this.isovalue + by];
    const keys = { ArrowLeft: less, ArrowDown: less, ArrowRight: more, ArrowUp: more, Home: low, End: high };
    const to = { ...keys, PageDown: this.isovalue - 10 * by, PageUp: this.isovalue + 10 * by }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    this.moveIsovalue(to, false);
  }

  moveIsovalue(value, live) {
    this.isovalue = clamp(value, ...this.isovalues());
    this.draw();
    this.viewer.set({ "options.isovalue": this.isovalue }, live);
  }

  // The window: the range of the colours

  makeWindow() {
    this.span = make("rect", { class: "clvol-span", y: GRAPH.height + 12 + GRAPH.strip, height: 4 });
    const labels = ["low end of the window", "high end of the window", "middle of the window"];
    const handles = labels.map((label, i) =>
      make("rect", {
        class: "clvol-handle",
        y: GRAPH.height + 7 + GRAPH.strip,
        width: i < 2 ? 10 : 18,
        height: 14,
        rx: 3,
        tabindex: 0,
        role: "slider",
        "aria-label": label,
        onpointerdown: (event) => this.dragWindow(event, i),
        onkeydown: (event) => this.keyOnWindow(event, i),
      }),
    );
    this.parts.window.append(this.span, handles[2], handles[0], handles[1]);
    return handles;
  }

  clim() {
    const window = this.viewer.state?.transfer?.points ? null : this.viewer.state?.window;
    if (window) return [window[0] - window[1] / 2, window[0] + window[1] / 2];
    return [this.points[0]?.[0] ?? this.range[0], this.points.at(-1)?.[0] ?? this.range[1]];
  }

  dragWindow(event, which) {
    if (event.button !== 0 || !this.points.length) return;
    this.held = true;
    event.target.focus({ preventScroll: true });
    const [first, ends, points] = [this.at(event).value, this.clim(), this.points];
    const moved = oncePerFrame((value) => this.moveWindow(ends, points, which, value - first, true));
    drag(event, event.target, (other) => moved(this.at(other).value), () => {
      moved.flush();
      this.held = false;
      this.viewer.settle();
    });
  }

  keyOnWindow(event, which) {
    const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!way || !this.points.length) return;
    event.preventDefault();
    event.stopPropagation();
    const by = (way * (event.shiftKey ? 5 : 1) * (this.range[1] - this.range[0])) / 200;
    this.moveWindow(this.clim(), this.points, which, by, false);
  }

  /** Moves one end, or both. Edited points move with it; those of a preset are moved by the session. */
  moveWindow([low, high], points, which, by, live) {
    const least = (this.range[1] - this.range[0]) / 1000;
    const ends = [which === 1 ? low : low + by, which === 0 ? high : high + by];
    if (ends[1] - ends[0] < least) ends[which === 0 ? 0 : 1] = which === 0 ? ends[1] - least : ends[0] + least;
    const scale = (ends[1] - ends[0]) / (high - low || 1);
    const shifted = points.map(([value, ...rest]) => [ends[0] + (value - low) * scale, ...rest]);
    if (this.viewer.state?.transfer?.points) return this.put(shifted, this.selected, live);
    this.points = shifted;
    this.viewer.set({ window: [(ends[0] + ends[1]) / 2, ends[1] - ends[0]] }, live);
    this.draw();
  }
}

// -- the transfer function of value and gradient, over how often both occur ----------------------------------------

const CORNERS = ["lower left", "lower right", "upper left", "upper right"].map((name, k) => ({ name: `${name} corner`, ends: [!(k % 2), Boolean(k % 2)], levels: [k < 2, k > 1] }));
const OF_ARCH = ["left foot", "right foot"].map((name, k) => ({ name, ends: [!k, Boolean(k)], levels: [false, false] }));
const WHOLE = { name: "", ends: [true, true], levels: [true, true] }; // what moves with a shape itself
const ARCH = Array.from({ length: 33 }, (_, k) => (k - 16) / 7); // of a Gaussian's integral, a blurred step
const SHADES = ["#e8a33d", "#4f9dde", "#57b894", "#d96c8a"]; // of shapes that are added
const ARCH_WIDTH = 0.3; // of the peak, as of TransferFunction2D

/** The error function, to 4e-4. */
const erf = (x) => Math.tanh(x * (1.1284 + 0.1009 * x * x));

/** Boxes, `{span, slopes, color, opacity}`, whose upper slope may be null, and arches, with a `peak` in place of slopes. */
class JointEditor {
  constructor(viewer) {
    this.viewer = viewer;
    this.shapes = [];
    this.selected = 0;
    this.held = false;
    this.counted = null; // the session's message "joint"
    this.room = { low: 0, high: 1, top: 1 };
    this.picture = make("image", { preserveAspectRatio: "none", class: "clvol-joint" });
    this.drawn = make("g", {});
    this.grips = make("g", {});
    for (let k = 0; k < CORNERS.length; k++) this.grips.append(this.makeGrip(k));
    this.svg = make("svg", { class: "clvol-graph", role: "group", "aria-label": "transfer function of value and gradient", height: GRAPH.height + 16 }, this.picture, this.drawn, this.grips);
    this.ends = [make("output", {}), make("output", {}), make("output", {})];
    const entry = (label) => make("input", { type: "number", step: "any", "aria-label": label, title: label, onchange: () => this.typed() });
    this.numbers = ["lowest value", "highest value", "lowest gradient", "highest gradient, or peak"].map(entry);
    this.opacity = make("input", { type: "number", min: 0, max: 1, step: 0.01, "aria-label": "opacity of the shape", title: "opacity", onchange: () => this.typed() });
    this.color = make("input", { type: "color", "aria-label": "colour of the shape" });
    const recolored = oncePerFrame(() => this.change({ color: rgb(this.color.value) }, true));
    this.color.addEventListener("input", recolored);
    this.color.addEventListener("change", () => (recolored.drop(), this.change({ color: rgb(this.color.value) })));
    this.adds = [["Box", "boxes"], ["Arch", "arches"]].map(([text, kind]) => button(text, () => this.add(kind), { label: `add ${text === "Box" ? "a box" : "an arch"}` }));
    this.remove = button("Delete", () => this.deleteShape(this.selected), { label: "delete the shape" });
    this.element = make(
      "div",
      { class: "clvol-transfer" },
      this.svg,
      make("div", { class: "clvol-ends" }, ...this.ends),
      make("div", { class: "clvol-shape-row" }, this.color, this.opacity, ...this.adds, this.remove),
      make("div", { class: "clvol-numbers" }, ...this.numbers),
    );
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.svg);
  }

  close() {
    this.observer.disconnect();
  }

  // Coordinates

  get width() {
    return Math.max(this.svg.clientWidth - 16, 50);
  }

  x(value) {
    const { low, high } = this.room;
    return 8 + (this.width * (value - low)) / (high - low);
  }

  y(slope) {
    return 8 + GRAPH.height * (1 - (slope ?? this.room.top) / this.room.top);
  }

  at(event) {
    const box = this.svg.getBoundingClientRect();
    const { low, high, top } = this.room;
    const share = clamp((event.clientX - box.left - 8) / this.width, 0, 1);
    return { value: low + share * (high - low), slope: top * clamp(1 - (event.clientY - box.top - 8) / GRAPH.height, 0, 1) };
  }

  // Drawing

  /** `transfer`: the state's. */
  show({ boxes = [], arches = [] }) {
    if (this.held) return;
    this.shapes = [
      ...boxes.map(([span, slopes, color, opacity]) => ({ span, slopes, color, opacity })),
      ...arches.map(([span, peak, color, opacity]) => ({ span, peak, color, opacity })),
    ];
    this.selected = clamp(this.selected, 0, Math.max(this.shapes.length - 1, 0));
    this.draw();
  }

  tell(counted) {
    this.counted = counted;
    this.picture.setAttribute("href", counted.image);
    this.draw();
  }

  /** All that is counted, and all shapes. */
  fit() {
    const edges = this.viewer.info?.histogram?.edges ?? [0, 1];
    const values = [...(this.counted?.values ?? [edges[0], edges.at(-1)]), ...this.shapes.flatMap((shape) => shape.span)];
    const slopes = this.shapes.flatMap(({ slopes, peak }) => (slopes ? slopes.filter((slope) => slope !== null) : [peak * (1 + ARCH_WIDTH)]));
    const [low, high] = [Math.min(...values), Math.max(...values)];
    this.room = { low, high: high > low ? high : low + 1, top: Math.max(this.counted?.steepest ?? 0, ...slopes) || 1 };
  }

  draw() {
    if (!this.held) this.fit();
    const { room, counted, shapes } = this;
    if (counted) {
      const [x, y] = [this.x(counted.values[0]), this.y(counted.steepest)];
      attributes(this.picture, { x, y, width: this.x(counted.values[1]) - x, height: this.y(0) - y });
    }
    const units = this.viewer.info?.volume?.units;
    [short(room.low, 3), `gradient to ${short(room.top, 3)}${units ? ` per ${units}` : ""}`, short(room.high, 3)].forEach((text, i) => (this.ends[i].value = text));
    while (this.drawn.children.length > shapes.length) this.drawn.lastChild.remove();
    while (this.drawn.children.length < shapes.length) this.drawn.append(this.makeShape(this.drawn.children.length));
    shapes.forEach((shape, i) => this.drawShape(shape, i));
    const chosen = shapes[this.selected];
    for (const input of [this.color, this.opacity, ...this.numbers]) input.disabled = !chosen;
    this.remove.disabled = shapes.length < 2;
    for (const add of this.adds) add.disabled = shapes.length >= 32;
    const grips = this.gripsOf(chosen);
    [...this.grips.children].forEach((grip, k) => {
      grip.style.display = grips[k] ? "" : "none";
      if (!grips[k]) return;
      const { name, ends, levels } = grips[k];
      const value = chosen.span[ends[0] ? 0 : 1];
      attributes(grip, { cx: this.x(value), cy: this.y(chosen.slopes ? chosen.slopes[levels[0] ? 0 : 1] : 0), fill: hex(chosen.color), "aria-label": name, ...this.words(chosen, value) });
    });
    if (!chosen) return;
    const [bottom, top] = chosen.slopes ?? [null, chosen.peak];
    [...chosen.span, bottom, top].forEach((value, i) => {
      if (document.activeElement !== this.numbers[i]) this.numbers[i].value = value === null ? "" : short(value, 5);
    });
    this.numbers[2].disabled = !chosen.slopes;
    this.numbers[3].placeholder = "no limit";
    if (document.activeElement !== this.opacity) this.opacity.value = short(chosen.opacity, 3);
    this.color.value = hex(chosen.color);
  }

  drawShape(shape, i) {
    const { span, slopes, peak, color, opacity } = shape;
    const [middle, half] = [(span[0] + span[1]) / 2, (span[1] - span[0]) / 2];
    const edge = (by) => ARCH.map((t) => [middle + half * erf(t), Math.max(0, peak * (Math.exp(-t * t) + by))]);
    const corners = slopes ? [[span[0], slopes[0]], [span[1], slopes[0]], [span[1], slopes[1]], [span[0], slopes[1]]] : [...edge(ARCH_WIDTH), ...edge(-ARCH_WIDTH).reverse()];
    attributes(this.drawn.children[i], {
      d: `M${corners.map(([value, slope]) => `${this.x(value).toFixed(1)} ${this.y(slope).toFixed(1)}`).join("L")}Z`,
      fill: hex(color),
      "fill-opacity": 0.15 + 0.6 * heightOf(opacity),
      "aria-label": `${slopes ? "box" : "arch"}, shape ${i + 1} of ${this.shapes.length}`,
      "aria-current": i === this.selected,
      ...this.words(shape, span[0]),
    });
  }

  /** What a reader of the screen says of a shape. */
  words({ span, slopes, peak, color, opacity }, value) {
    const steep = slopes ? `gradients ${short(slopes[0])} to ${slopes[1] === null ? "any" : short(slopes[1])}` : `peak ${short(peak)}`;
    const text = `values ${short(span[0])} to ${short(span[1])}, ${steep}, opacity ${short(opacity, 3)}, colour ${hex(color)}`;
    return { "aria-valuemin": this.room.low, "aria-valuemax": this.room.high, "aria-valuenow": value, "aria-valuetext": text };
  }

  gripsOf(shape) {
    return shape ? (shape.slopes ? CORNERS : OF_ARCH) : [];
  }

  // Shapes

  makeShape(index) {
    const element = make("path", { class: "clvol-shape", tabindex: 0, role: "slider", onfocus: () => this.select(index) });
    return this.movable(element, () => index, () => WHOLE);
  }

  makeGrip(k) {
    return this.movable(make("circle", { class: "clvol-dot", r: 5, tabindex: 0, role: "slider", "aria-label": CORNERS[k].name }), () => this.selected, () => this.gripsOf(this.shapes[this.selected])[k]);
  }

  /** An element that moves a shape, or a part of one, by pointer and keys. */
  movable(element, index, grip) {
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      element.focus({ preventScroll: true });
      this.held = true;
      const [i, first, at] = [index(), this.shapes[index()], this.at(event)];
      const moved = oncePerFrame((to) => this.put(this.shapes.with(i, this.moved(first, grip(), to.value - at.value, to.slope - at.slope)), i, true));
      drag(event, element, (other) => moved(this.at(other)), () => {
        moved.flush();
        this.held = false;
        this.viewer.settle();
      });
    });
    element.addEventListener("dblclick", () => this.color.click());
    element.addEventListener("contextmenu", (event) => {
      event.preventDefault();
      this.deleteShape(index());
    });
    element.addEventListener("keydown", (event) => {
      const by = (event.shiftKey ? 5 : 1) / 100;
      const [way, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [];
      const { low, high, top } = this.room;
      if (way !== undefined) this.put(this.shapes.with(index(), this.moved(this.shapes[index()], grip(), way * by * (high - low), up * by * top)), index());
      else if (event.key === "Delete" || event.key === "Backspace") this.deleteShape(index());
      else if (event.key === "Enter" || event.key === " ") this.color.focus();
      else if (event.key === "Insert" || event.key === "+") this.add(this.shapes[index()].slopes ? "boxes" : "arches");
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    return element;
  }

  /** A shape whose ends and levels have moved as far as that leaves it wide enough; at the upper edge a box has no limit. */
  moved(shape, { ends, levels }, right, up) {
    const { low, high, top } = this.room;
    const [wide, tall] = [(high - low) / 100, top / 50];
    const span = shape.span.map((value, k) => (ends[k] ? value + right : value));
    if (span[1] - span[0] < wide) span[ends[0] ? 0 : 1] = ends[0] ? span[1] - wide : span[0] + wide;
    if (!shape.slopes) return { ...shape, span, peak: Math.max(shape.peak + (levels[1] ? up : 0), tall) };
    let [bottom, limit] = shape.slopes;
    const most = levels[1] && limit !== null ? Infinity : (limit ?? top) - tall;
    if (levels[0]) [up, bottom] = [clamp(up, -bottom, most - bottom), clamp(bottom + up, 0, most)];
    if (levels[1] && (limit !== null || !levels[0])) {
      limit = Math.max((limit ?? top) + up, bottom + tall);
      if (!levels[0] && limit >= top) limit = null;
    }
    return { ...shape, span, slopes: [bottom, limit] };
  }

  select(index) {
    this.selected = index;
    this.draw();
  }

  change(changes, live = false) {
    if (this.shapes[this.selected]) this.put(this.shapes.with(this.selected, { ...this.shapes[this.selected], ...changes }), this.selected, live);
  }

  typed() {
    const [low, high, bottom, top] = this.numbers.map((input) => (input.value === "" ? null : Number(input.value)));
    const shape = this.shapes[this.selected];
    const steep = shape.slopes ? { slopes: [bottom ?? 0, top] } : { peak: top ?? shape.peak };
    this.change({ span: [low ?? shape.span[0], high ?? shape.span[1]], ...steep, opacity: clamp(Number(this.opacity.value), 0, 1) });
  }

  /** Adds a shape in the middle, in the colour that follows. */
  add(kind) {
    const { low, high, top } = this.room;
    const color = rgb(SHADES[this.shapes.length % SHADES.length]);
    const span = [low + 0.4 * (high - low), low + 0.6 * (high - low)];
    const made = { span, color, opacity: 0.5, ...(kind === "boxes" ? { slopes: [0.3 * top, 0.7 * top] } : { peak: 0.5 * top }) };
    const boxes = this.shapes.filter((shape) => shape.slopes).length;
    const index = kind === "boxes" ? boxes : this.shapes.length;
    this.put(this.shapes.toSpliced(index, 0, made), index);
    this.drawn.children[index]?.focus();
  }

  deleteShape(index) {
    if (this.shapes.length < 2) return;
    this.put(this.shapes.toSpliced(index, 1), Math.max(index - 1, 0));
    this.drawn.children[this.selected]?.focus();
  }

  put(shapes, selected, live = false) {
    this.shapes = shapes;
    this.selected = selected;
    this.draw();
    const boxes = shapes.filter((shape) => shape.slopes).map(({ span, slopes, color, opacity }) => [span, slopes, color, opacity]);
    const arches = shapes.filter((shape) => !shape.slopes).map(({ span, peak, color, opacity }) => [span, peak, color, opacity]);
    const { image, ...rest } = this.viewer.state.transfer; // shapes are in place of an image
    this.viewer.set(image ? { transfer: { ...rest, boxes, arches } } : { "transfer.boxes": boxes, "transfer.arches": arches }, live);
  }
}

// -- the wiper: another filter's picture to the right of a bar --------------------------------------------------

class Wiper {
  constructor(pane) {
    this.pane = pane;
    this.left = make("span", { class: "clvol-wiper-left" });
    this.right = make("span", { class: "clvol-wiper-right" });
    this.element = make(
      "div",
      { class: "clvol-wiper clvol-grip", role: "slider", tabindex: 0, "aria-label": "bar between two filters", "aria-valuemin": 0, "aria-valuemax": 100 },
      this.left,
      this.right,
    );
    const moved = oncePerFrame((at, live) => this.move(at, live));
    this.element.addEventListener("pointerdown", (event) => {
      const box = pane.element.getBoundingClientRect();
      const at = (other) => clamp((other.clientX - box.left) / box.width, 0, 1);
      this.element.focus({ preventScroll: true });
      drag(event, this.element, (other) => moved(at(other), true), (other) => (moved.drop(), this.move(at(other), false)));
    });
    this.element.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!way) return;
      event.preventDefault();
      event.stopPropagation();
      this.move(clamp((pane.viewer.state.wiper?.at ?? 0.5) + way * (event.shiftKey ? 0.1 : 0.02), 0, 1), false);
    });
  }

  move(at, live) {
    this.pane.viewer.set({ "wiper.at": Math.round(at * 1e4) / 1e4 }, live);
  }

  /** `own`: the full name of the filter in use; `errors`: of both filters, once they are measured. */
  show(state, own, errors) {
    const { wiper } = state;
    this.element.hidden = !wiper;
    if (!wiper) return;
    this.element.style.left = `${100 * wiper.at}%`;
    attributes(this.element, { "aria-valuenow": Math.round(100 * wiper.at), "aria-valuetext": `${Math.round(100 * wiper.at)} % from the left` });
    [[this.left, own ?? state.filter], [this.right, wiper.filter]].forEach(([place, name], i) => {
      const { expected, rms } = errors?.[i] ?? {};
      const error = Number.isFinite(expected) ? `expected error ${short(expected, 3)}` : Number.isFinite(rms) ? `error ${short(rms, 3)}` : "";
      place.textContent = error ? `${name} · ${error}` : name;
    });
  }
}

// -- the panel ---------------------------------------------------------------------------------------------------

const LIGHTS = {
  automatic: null,
  headlight: [{ direction: null }],
  "from the left": [{ direction: [-0.8, 0.4, 0.6], frame: "camera" }],
  "from the right": [{ direction: [0.8, 0.4, 0.6], frame: "camera" }],
  "from above": [{ direction: [0, 0.95, 0.4], frame: "camera" }],
};
/** What stands around the picture, by its word: the label and a hint. */
const AROUND = {
  color_bar: ["Colour bar", "the transfer function's colours with their values"],
  scale_bar: ["Scale bar", "true at the depth of what the camera looks at"],
  axes: ["Axes", "ticks with the world's coordinates"],
  box: ["Box", "the edges around the volume"],
  letters: ["Letters", "the sides of the patient"],
  cube: ["Cube", "is turned like the world"],
};
const MATERIAL = { ambient: [0, 1, 0.25], diffuse: [0, 1.5, 0.75], specular: [0, 1, 0.2], shininess: [1, 120, 30] };
/** How dark it is where matter stops light, by its word: the label and a hint. */
const DARK = {
  shadow: ["Shadow", "of lights, which then stand still while the camera moves"],
  occlusion: ["Occlusion", "of light from all around"],
};
const TOOL_HINT = "what the first button drags";
const EDITED = "\u0000edited";
const LOOKED_FOR = 12; // labels from which there is a search field
const LISTED = 200; // channels that are listed; more have a slider
const TYPED = 150; // milliseconds without typing before a search

/** Which labels of a label map are seen: a row for each of the first that match the filter; the session searches. */
class Labels {
  constructor(viewer) {
    this.viewer = viewer;
    this.listed = null; // labels of the volume that the session sent first
    this.boxes = new Map(); // the controls of a row, by number
    this.filter = make("input", { type: "search", placeholder: "name or number", "aria-label": "filter the labels", maxlength: 200 });
    this.filter.addEventListener("input", () => {
      clearTimeout(this.typing);
      this.typing = setTimeout(() => this.find(), TYPED);
    });
    const all = button("All", () => viewer.set({ labels: null }), { title: "show all labels" });
    const none = button("None", () => viewer.set({ labels: { shown: [] } }), { title: "hide all labels" });
    const given = button("Reset", () => viewer.set({ label_colors: {}, label_opacities: {} }), { title: "colours and opacities as given" });
    const head = make("div", { class: "clvol-buttons", role: "toolbar", "aria-label": "all labels" }, all, none, given, this.filter);
    this.list = make("ul", { class: "clvol-labels", "aria-label": "labels" });
    this.note = make("p", { class: "clvol-note", "aria-live": "polite" });
    this.element = section("Labels", true, head, this.list, this.note);
  }

  close() {
    clearTimeout(this.typing);
  }

  tell(info) {
    this.listed = info.labels ?? null;
    this.element.hidden = !this.listed;
    if (!this.listed) return;
    this.filter.hidden = this.listed.count <= LOOKED_FOR;
    if (this.filter.hidden) this.filter.value = "";
    this.fill(this.listed);
    if (this.filter.value) this.find();
  }

  /** Requests the labels that match the filter. */
  async find() {
    const words = this.filter.value;
    const answer = words ? await this.viewer.ask("labels", { words }).catch(() => null) : { message: this.listed }; // the error is shown already
    if (!answer || words !== this.filter.value) return; // the text has changed meanwhile
    this.fill(answer.message);
    this.show(this.viewer.state);
  }

  fill({ rows, count }) {
    this.found = count;
    this.boxes.clear();
    this.list.replaceChildren(...rows.map((label) => this.rowOf(label)));
  }

  rowOf([number, name, color, opacity]) {
    const box = make("input", { type: "checkbox", onchange: () => this.put(number, box.checked) });
    const words = name || String(number);
    const swatch = make("input", { type: "color", class: "clvol-swatch", "aria-label": `colour of ${words}` });
    const seen = make("input", { type: "range", min: 0, max: 1, step: 0.01, "aria-label": `opacity of ${words}`, title: "opacity" });
    for (const [event, live] of [["input", true], ["change", false]]) {
      swatch.addEventListener(event, () => this.look("label_colors", number, rgb(swatch.value), live));
      seen.addEventListener(event, () => this.look("label_opacities", number, Number(seen.value), live));
    }
    this.boxes.set(number, { box, swatch, seen, color, opacity });
    const text = make("span", { title: name ? `${name}: label ${number}` : null }, words);
    const only = button("Only", () => this.viewer.set({ labels: { shown: [number] } }), { label: `show only ${words}` });
    return make("li", {}, make("label", { class: "clvol-check" }, box, text), swatch, seen, only);
  }

  /** Changes the colour or the opacity of a label; what else gives labels their colours goes. */
  look(word, number, value, live) {
    const changed = { ...this.viewer.state[word], [number]: value };
    this.viewer.set({ transfer: null, preset: null, window: null, cmap: null, [word]: changed }, live);
  }

  /** Shows or hides one label. */
  put(number, on) {
    const { labels } = this.viewer.state;
    const what = labels?.shown ? "shown" : "hidden";
    const rest = (labels?.[what] ?? []).filter((one) => one !== number);
    const made = on === (what === "shown") ? [...rest, number] : rest;
    this.viewer.set({ labels: what === "hidden" && !made.length ? null : { [what]: made } });
  }

  show({ labels, label_colors: colors, label_opacities: opacities }) {
    if (!this.listed) return;
    const chosen = new Set(labels?.shown ?? labels?.hidden ?? []);
    for (const [number, { box, swatch, seen, color, opacity }] of this.boxes) {
      box.checked = chosen.has(number) === Boolean(labels?.shown);
      swatch.value = hex(colors[number] ?? color);
      if (!seen.matches(":active")) seen.value = opacities[number] ?? opacity; // not while it is held
    }
    const { count } = this.listed;
    const seen = labels?.shown ? chosen.size : Math.max(count - chosen.size, 0);
    const [listed, some] = [this.boxes.size, this.filter.value ? "of these" : "of them"];
    const found = this.filter.value ? `; ${this.found} found` : "";
    this.note.textContent = `${seen} of ${count} shown${found}${listed < this.found ? `; the first ${listed} ${some} are listed` : ""}`;
  }
}

/** The media of a scene: whether each is seen, and the colours and opacity of those beside the first, which the panel edits. */
class Media {
  constructor(viewer) {
    this.viewer = viewer;
    this.about = [];
    this.rows = [];
    this.body = make("div", {});
    this.element = section("Media", true, this.body);
    this.element.hidden = true;
  }

  tell({ media = [], colormaps = [] }) {
    this.element.hidden = media.length < 2;
    if (same(media, this.about)) return;
    this.about = media;
    this.rows = media.map((about, k) => this.rowOf(about, k, colormaps));
    this.body.replaceChildren(...this.rows.flatMap((row) => Object.values(row).map((control) => control.element)));
  }

  rowOf({ name, edited }, k, colormaps) {
    const row = { visible: toggle(name, (on) => this.put(k, "visible", on), "whether it is seen") };
    if (!edited) return row;
    row.cmap = choice("Colours", (value) => this.put(k, "cmap", value || null), `of ${name}`);
    row.cmap.fill([["", "as given"], ...colormaps]);
    row.opacity = slider("Opacity", { low: 0, high: 2 }, (value, live) => this.put(k, "opacity", Math.max(0, value), live), `of ${name}`);
    return row;
  }

  put(k, word, value, live = false) {
    const media = this.about.map((_, i) => ({ ...(this.viewer.state.media[i] ?? {}) }));
    media[k][word] = value;
    this.viewer.set({ media }, live);
  }

  show({ media }) {
    this.rows.forEach((row, k) => {
      for (const [word, control] of Object.entries(row)) control.show(media[k]?.[word] ?? this.about[k][word] ?? (word === "opacity" ? 1 : null));
    });
  }
}

/** Which of several volumes on one grid is shown: a list or a slider for each leading axis. */
class Axes {
  constructor(viewer) {
    this.viewer = viewer;
    this.about = [];
    this.controls = [];
    this.body = make("div", {});
    this.element = section("Volumes", true, this.body);
    this.element.hidden = true;
  }

  tell({ axes = [] }) {
    this.element.hidden = !axes.length;
    if (same(axes, this.about)) return; // do not replace a slider that is held
    this.about = axes;
    this.controls = axes.map((about) => this.controlOf(about));
    this.body.replaceChildren(...this.controls.map((control) => control.element));
  }

  controlOf({ axis, count, names, first }) {
    const put = (value, live = false) => this.viewer.set({ [`index.${axis}`]: value }, live);
    const hint = `which ${axis} is shown`;
    if (!first && (axis === "channel" ? count > LISTED : names.length < count))
      return slider(axis, { low: 0, high: count - 1, step: 1 }, (value, live) => put(clamp(Math.round(value), 0, count - 1), live), hint);
    const control = choice(axis, (value) => put(value === first ? value : Number(value)), hint);
    const places = Array.from({ length: count }, (_, i) => [i, names[i] ?? i]);
    control.fill(first ? [[first, first], ...places] : places);
    return control;
  }

  show({ index }) {
    this.about.forEach(({ axis, first }, i) => this.controls[i].show(index[axis] ?? first));
  }
}

class Panel {
  constructor(viewer) {
    this.viewer = viewer;
    this.options = make("div", { class: "clvol-options" });
    this.transfer = new TransferEditor(viewer);
    this.joint = new JointEditor(viewer);
    this.axes = new Axes(viewer);
    this.media = new Media(viewer);
    this.labels = new Labels(viewer);
    this.made = null; // mode whose options are shown
    this.element = make("div", { class: "clvol-panel", role: "region", "aria-label": "settings" });
    this.element.append(
      this.toolbar(),
      this.axes.element,
      this.media.element,
      this.labels.element,
      section("Look", true, this.lookControls()),
      section("Reconstruction", true, this.filterControls()),
      section("Slices", false, this.sliceControls()),
      section("Camera", false, this.cameraControls()),
      section("Light", false, this.lightControls()),
      section("Clip planes", false, this.cropControls()),
      section("Around the picture", false, this.aroundControls()),
      section("Share", true, this.shareControls()),
      section("Statistics", false, this.statisticsControls()),
      (this.keySection = section("Keys", false)),
    );
  }

  close() {
    this.transfer.close();
    this.joint.close();
    this.labels.close();
  }

  /** Sets one field as soon as a control changes. */
  setter(name, read = (value) => value) {
    return (value, live = false) => this.viewer.set({ [name]: read(value) }, live);
  }

  toolbar() {
    const { viewer } = this;
    this.undo = button("Undo", () => viewer.ask("undo"), { title: "undo (Ctrl+Z)" });
    this.redo = button("Redo", () => viewer.ask("redo"), { title: "redo (Ctrl+Shift+Z)" });
    const fit = button("Fit", () => viewer.ask("fit"), { title: "fit the view to the volume" });
    const reset = button("Reset", () => viewer.ask("reset"), { title: "back to the first state" });
    this.layout = choice("Layout", (value) => viewer.set(value === "slice" ? this.oneSlice() : { layout: value }));
    this.layout.fill([["3d", "3-D"], ["slice", "slice"], ["linked", "3-D and slices"]]);
    this.tool = choice("Drag", this.setter("tool", (value) => value || null), TOOL_HINT);
    this.tool.fill([["", "orbit, crosshair"], ["pan", "pan"], ["zoom", "zoom"], ["roll", "roll"], ["window", "window"], ["isovalue", "isovalue"], ["crop", "clip planes"]]);
    const bar = make("div", { class: "clvol-buttons", role: "toolbar", "aria-label": "history and view" }, this.undo, this.redo, fit, reset);
    return make("div", { class: "clvol-head" }, bar, this.layout.element, this.tool.element);
  }

  oneSlice() {
    const { active } = this.viewer.state;
    return { layout: "slice", active: active === "3d" ? "z" : active };
  }

  lookControls() {
    this.mode = choice("Mode", this.setter("mode"));
    this.preset = choice("Preset", (value) => {
      if (value !== EDITED) this.viewer.set({ transfer: null, preset: value || null, window: null, cmap: null, opacity: null });
    });
    this.cmap = choice("Colours", (value) => this.viewer.set({ transfer: null, cmap: value || null }), "colour map instead of the preset's colours");
    this.opacity = slider("Opacity ×", { low: 0, high: 4 }, this.setter("opacity"), "factor on all opacities of the preset");
    this.edges = slider("Edges", { low: 0, high: 1 }, this.setter("gradient_opacity"), "how much of the opacity is missing where values do not change");
    this.graded = toggle("By the gradient too", (on) => this.grade(on), "colours and opacities of boundaries, by value and gradient");
    const file = make("input", { type: "file", accept: ".json,application/json", "aria-label": "file of colours", hidden: true, onchange: () => this.load(file) });
    this.saved = button("Save colours", () => this.save(), { title: "colours and opacities as JSON" });
    const load = button("Load colours", () => file.click(), { title: "colours and opacities from JSON" });
    const files = make("div", { class: "clvol-buttons" }, this.saved, load, file);
    const edited = [this.transfer, this.joint, this.graded, this.cmap, this.opacity, this.edges].map((control) => control.element);
    return make("div", {}, this.mode.element, this.options, this.preset.element, ...edited, files);
  }

  /** A function of value and gradient in place of one of values, or that of the preset. */
  async grade(on) {
    const answer = on ? await this.viewer.ask("joint").catch(() => null) : null; // the error is shown already
    this.viewer.set({ transfer: answer?.message.transfer ?? null });
  }

  save() {
    this.viewer.download(new Blob([JSON.stringify(this.colored)], { type: "application/json" }), "colours.json");
  }

  async load(file) {
    const [chosen] = file.files;
    file.value = ""; // the same one may be chosen again
    if (!chosen) return;
    try {
      this.viewer.set({ transfer: JSON.parse(await chosen.text()) });
    } catch {
      this.viewer.status(`${chosen.name} is no JSON`, "error");
    }
  }

  filterControls() {
    this.filter = choice("Filter", this.setter("filter", (value) => value || null), "reconstruction filter between samples");
    this.boundary = choice("Boundary", this.setter("boundary"), "values outside the volume");
    this.step = slider("Step", { low: 0.1, high: 2, step: 0.05 }, this.setter("step"), "distance between samples along a ray, in voxels");
    this.compare = toggle("Compare with", (on) => this.viewer.set({ wiper: on ? { filter: this.other.list.value || "linear", at: 0.5 } : null }), "A/B: another filter to the right of a bar");
    this.other = choice("Other filter", (value) => this.viewer.state.wiper && this.viewer.set({ "wiper.filter": value }));
    this.errors = make("p", { class: "clvol-note", "aria-live": "polite" });
    return make("div", {}, this.filter.element, this.boundary.element, this.step.element, this.compare.element, this.other.element, this.errors);
  }

  sliceControls() {
    this.plane = choice("Slice", (value) => this.viewer.set({ active: value }));
    this.crosshair = ["x", "y", "z"].map((axis, i) =>
      slider(axis, { low: 0, high: 1 }, (value, live) => {
        const at = [...(this.viewer.state.crosshair ?? this.viewer.info.volume.center)];
        at[i] = value;
        this.viewer.set({ crosshair: at }, live);
      }),
    );
    return make("div", {}, this.plane.element, ...this.crosshair.map((c) => c.element));
  }

  cameraControls() {
    this.projection = choice("Projection", this.setter("camera.projection"));
    this.projection.fill(["perspective", "orthographic"]);
    this.style = choice("Orbit", this.setter("camera.style"), "about the vertical, or freely");
    this.style.fill(["turntable", "trackball"]);
    this.fov = slider("Angle of view", { low: 5, high: 100, step: 1 }, this.setter("camera.fov"));
    this.zoom = slider("Zoom (log₂)", { low: -3, high: 6 }, this.setter("camera.zoom", (value) => 2 ** clamp(value, -4, 9)));
    return make("div", {}, this.projection.element, this.style.element, this.fov.element, this.zoom.element);
  }

  lightControls() {
    this.light = choice("Lights", (name) => this.viewer.set({ lights: LIGHTS[name] ?? null }));
    this.light.fill(Object.keys(LIGHTS));
    this.material = Object.entries(MATERIAL).map(([name, [low, high]]) => [name, slider(name, { low, high }, this.setter(`material.${name}`))]);
    this.dark = Object.entries(DARK).map(([name, [label, hint]]) => [name, slider(label, { low: 0, high: 1 }, this.setter(name), hint)]);
    this.rays = toggle("Exact shadows", this.setter("shadow_rays"), "of exact surfaces, in memory: by rays to the lights");
    this.linear = toggle("Linear light", this.setter("linear_light"), "colours are computed in linear light");
    this.background = colorBox("Background", this.setter("background"));
    return make("div", {}, this.light.element, ...this.dark.map(([, c]) => c.element), this.rays.element, this.linear.element, ...this.material.map(([, c]) => c.element), this.background.element);
  }

  cropControls() {
    const hint = "six planes across the axes: drag their dots in the picture, or set them here";
    this.cropping = toggle("Crop to a box", (on) => this.viewer.set({ clip: on ? this.box() : null }), hint);
    this.crop = ["x", "y", "z"].flatMap((axis, i) =>
      ["low", "high"].map((side) => slider(`${axis} ${side === "low" ? "from" : "to"}`, { low: 0, high: 1 }, (value, live) => this.cropTo(i, side, value, live))),
    );
    return make("div", {}, this.cropping.element, ...this.crop.map((c) => c.element));
  }

  /** What stands around the picture at rest: furniture, by the words of `clvol.render`. */
  aroundControls() {
    const change = (name) => this.setter(`furniture.${name}`);
    const toggles = Object.entries(AROUND).map(([name, [label, hint]]) => [name, toggle(label, change(name), hint)]);
    const texts = [["title", textBox("Title", change("title"))], ["time_stamp", textBox("Time stamp", change("time_stamp"))]];
    this.around = [...toggles, ...texts];
    const theme = (name, color) => button(name, () => this.viewer.set({ background: color }), { title: `on ${name === "print" ? "white" : "black"}` });
    const themes = make("div", { class: "clvol-buttons" }, make("span", {}, "Theme"), theme("screen", [0, 0, 0]), theme("print", [1, 1, 1]));
    return make("div", {}, ...this.around.map(([, control]) => control.element), themes);
  }

  shareControls() {
    const { viewer } = this;
    const copy = (what, name) => button(name, () => viewer.copy(what, name), { title: `copy this picture as ${name}` });
    const buttons = [copy("copy_python", "Python"), copy("copy_toml", "TOML"), copy("copy_url", "URL")];
    const save = button("Save picture", () => viewer.save("save_picture"), { title: "the final picture, lossless" });
    this.movie = button("Save movie", () => viewer.save("movie", { format: this.movieAs.value }), { title: "one turn" });
    this.movieAs = make("select", { "aria-label": "movie format" }, new Option("GIF", "gif"), new Option("MP4", "mp4"), new Option("WebM", "webm"), new Option("PNGs in a zip", "zip"));
    this.text = make("textarea", { class: "clvol-text", readonly: true, rows: 4, hidden: true, "aria-label": "text to copy" });
    return make("div", {}, make("div", { class: "clvol-buttons" }, make("span", {}, "Copy as"), ...buttons), make("div", { class: "clvol-buttons" }, save, make("span", { class: "clvol-together" }, this.movie, this.movieAs)), this.text);
  }

  statisticsControls() {
    this.statistics = make("dl", { class: "clvol-statistics" });
    this.heat = toggle("Show visited samples", this.setter("heat"), "heat map of the fraction of samples that rays visit");
    return make("div", {}, this.statistics, this.heat.element);
  }

  // The volume

  /** The crop box, by default the whole volume. */
  box() {
    const [low, high] = this.viewer.info.volume.bounds;
    return { low, high };
  }

  cropTo(axis, side, value, live) {
    const clip = structuredClone(this.viewer.state.clip ?? this.box());
    const { low, high } = this.box();
    const least = (high[axis] - low[axis]) / 1000;
    clip[side][axis] = side === "low" ? Math.min(value, clip.high[axis] - least) : Math.max(value, clip.low[axis] + least);
    this.viewer.set({ clip }, live);
  }

  tell(info) {
    const names = (found) => (Array.isArray(found) ? found.map((f) => f.name ?? f) : Object.keys(found ?? {}));
    this.mode.fill(names(info.modes));
    this.filter.fill([["", "the mode's"], ...names(info.filters)]);
    this.other.fill(names(info.filters));
    this.other.show("linear");
    this.boundary.fill(names(info.boundaries).length ? names(info.boundaries) : ["mirror"]);
    this.boundary.element.hidden = names(info.boundaries).length < 2;
    this.preset.fill([["", "automatic"], ...names(info.presets)]);
    this.cmap.fill([["", "the preset's"], ...names(info.colormaps)]);
    this.plane.fill(["z", "y", "x"].map((axis) => [axis, this.viewer.paneName(axis)]));
    const { low, high } = this.box();
    [...this.crosshair.entries()].forEach(([i, c]) => c.limit(low[i], high[i]));
    this.crop.forEach((c, i) => c.limit(low[i >> 1], high[i >> 1]));
    this.made = null;
    this.around.find(([name]) => name === "letters")[1].element.hidden = info.volume.space !== "LPS";
    this.axes.tell(info);
    this.media.tell(info);
    this.labels.tell(info);
    const keys = Object.entries(info.keys ?? {});
    const list = make("dl", { class: "clvol-statistics clvol-keys" }, ...keys.flatMap(([key, text]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, text)]));
    this.keySection.lastElementChild.replaceChildren(list);
    this.keySection.hidden = !keys.length;
  }

  show(state) {
    const { viewer } = this;
    this.undo.disabled = !viewer.canUndo;
    this.redo.disabled = !viewer.canRedo;
    this.layout.show(state.layout);
    this.tool.show(state.tool === "orbit" || state.tool === "crosshair" ? "" : state.tool);
    this.mode.show(state.mode);
    this.showOptions(state);
    const matter = state.mode === "composite" && !viewer.info.volume.labels;
    const edited = Boolean(state.transfer?.points || (state.transfer && matter));
    const joint = edited && !state.transfer.points;
    this.colored = edited ? state.transfer : viewer.effective.transfer;
    this.saved.disabled = !this.colored || this.colored.points?.length === 0; // of many labels
    this.preset.show(edited ? EDITED : state.preset);
    this.nameEdited(edited);
    this.cmap.show(state.cmap);
    this.opacity.show(state.opacity ?? 1);
    this.opacity.element.hidden = edited;
    this.graded.show(joint);
    this.graded.element.hidden = !matter;
    this.transfer.element.hidden = joint;
    this.joint.element.hidden = !joint;
    if (joint) this.joint.show(state.transfer);
    this.edges.show(state.gradient_opacity);
    this.edges.element.hidden = state.mode !== "composite";
    const isovalue = typeof state.options.isovalue === "number" ? state.options.isovalue : viewer.effective.options?.isovalue; // not "3sigma"
    this.transfer.show(state.transfer?.points ?? viewer.effective.transfer?.points, state.mode === "isosurface" ? isovalue : null);
    this.filter.show(state.filter);
    this.boundary.show(state.boundary);
    this.step.show(state.step);
    this.compare.show(state.wiper);
    this.other.element.hidden = this.errors.hidden = !state.wiper;
    this.filter.list.options[0].textContent = state.filter || !viewer.effective.filter ? "the mode's" : `the mode's: ${viewer.effective.filter}`;
    if (state.wiper) this.other.show(state.wiper.filter);
    this.plane.show(state.active === "3d" ? "z" : state.active);
    (state.crosshair ?? viewer.info.volume.center).forEach((value, i) => this.crosshair[i].show(value));
    this.projection.show(state.camera.projection);
    this.style.show(state.camera.style);
    this.fov.show(state.camera.fov);
    this.zoom.show(Math.log2(state.camera.zoom ?? 1));
    this.light.show(this.lightName(state.lights));
    for (const [name, control] of this.material) control.show(state.material?.[name] ?? MATERIAL[name][2]);
    const factors = state.transfer?.gradient_opacity || state.transfer?.curvature_opacity;
    const graded = state.mode === "composite" && (state.gradient_opacity > 0 || joint || factors);
    const passes = graded || !viewer.info.stops_light ? "light is stopped by values alone: not beside Edges, or opacity by the gradient too" : "";
    for (const [name, control] of this.dark) {
      control.show(state[name]);
      control.unheard(passes);
    }
    this.rays.show(state.shadow_rays);
    this.linear.show(state.linear_light);
    this.background.show(state.background ?? [0, 0, 0]);
    this.cropping.show(state.clip);
    const { low, high } = state.clip ?? this.box();
    this.crop.forEach((c, i) => {
      c.show((i % 2 ? high : low)[i >> 1]);
      c.element.hidden = !state.clip;
    });
    for (const [name, control] of this.around) control.show(state.furniture[name]);
    this.heat.show(state.heat);
    this.axes.show(state);
    this.media.show(state);
    this.labels.show(state);
  }

  nameEdited(edited) {
    for (const option of [...this.preset.list.options].filter((o) => o.value === EDITED)) {
      option.textContent = "edited";
      if (!edited) option.remove();
    }
  }

  lightName(lights) {
    const plain = (list) => list && list.map((l) => [l.direction && l.direction.map((c) => c / Math.hypot(...l.direction)).map((c) => c.toFixed(3)), l.frame ?? "world"]);
    return Object.keys(LIGHTS).find((name) => same(plain(LIGHTS[name]), plain(lights))) ?? "others";
  }

  /** A control for each option of the mode, by its kind. */
  showOptions(state) {
    const known = this.viewer.info.modes[state.mode] ?? {};
    if (this.made !== state.mode) {
      this.made = state.mode;
      this.optionControls = Object.entries(known).map(([name, about]) => [name, about, this.optionControl(name, about)]);
      this.options.replaceChildren(...this.optionControls.map(([, , control]) => control.element));
    }
    for (const [name, about, control] of this.optionControls) control.show(state.options?.[name] ?? this.viewer.effective.options?.[name] ?? about.default);
  }

  optionControl(name, about) {
    const change = this.setter(`options.${name}`);
    const edges = this.viewer.info.histogram?.edges ?? [0, 1];
    if (about.kind === "flag") return toggle(name, change, about.help);
    if (about.kind === "color") return colorBox(name, change);
    if (about.kind === "surfaces") return surfacesBox(name, change, about.help);
    if (about.kind === "choice") {
      const made = choice(name, change, about.help);
      made.fill(about.choices);
      return made;
    }
    const [low, high] = name === "isovalue" ? [edges[0], edges.at(-1)] : (about.range ?? [0, 1]);
    return slider(name, { low, high, step: about.step, scale: about.scale, open: true }, change, about.help);
  }

  /** `errors`: measured by the session for both filters. */
  tellErrors(errors) {
    const known = (value, digits = 3) => (Number.isFinite(value) ? short(value, digits) : "unknown");
    const lines = (errors?.filters ?? []).map((e) => `${e.filter}: left out ${known(e.rms)}, expected ${known(e.expected)}`);
    this.errors.replaceChildren(...lines.flatMap((line) => [line, make("br")]), errors ? errors.problem ?? errors.meaning ?? "" : "measuring the errors");
  }

  stats(stats) {
    const rows = [
      ["frames per second", short(stats.fps, 3)],
      ["latency", Number.isFinite(stats.latency_ms) ? `${short(stats.latency_ms, 3)} ms` : NOTHING],
      ["samples visited", Number.isFinite(stats.visited) ? `${short(100 * stats.visited, 3)} %` : NOTHING],
      ["picture", stats.picture ?? NOTHING],
    ];
    this.statistics.replaceChildren(...rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
  }
}

// -- the viewer: panes, panel, and the channel to the session ----------------------------------------------------

class Viewer {
  constructor(element, channel, { embedded = false, onLink = null } = {}) {
    Object.assign(this, { channel, embedded, onLink });
    this.info = null;
    this.state = null;
    this.confirmed = null; // the session's last state
    this.unheard = []; // changes that it does not include
    this.lastSet = 0;
    this.effective = {}; // values where the state leaves them open
    this.errors = null; // of the wiper's filters
    this.overlays = new Map(); // the last message of each pane
    this.panes = new Map();
    this.asked = new Map();
    this.lastId = 0;
    this.gesture = 0; // number of the gesture, which is one step of undo
    this.picture = NOTHING;
    this.grid = make("div", { class: "clvol-panes" });
    this.line = make("div", { class: "clvol-status", role: "status", "aria-live": "polite" }, WAITING);
    this.panel = new Panel(this);
    this.hide = button("Settings", () => this.togglePanel(), { kind: "clvol-hide", title: "show or hide the settings" });
    this.hide.setAttribute("aria-expanded", "true");
    const stage = make("div", { class: "clvol-stage" }, this.grid, make("div", { class: "clvol-foot" }, this.line, this.hide));
    this.inner = make("div", { class: "clvol-frame" }, stage, this.panel.element);
    this.root = make("div", { class: `clvol${embedded ? " clvol-embedded" : ""}` }, this.inner);
    this.root.addEventListener("keydown", (event) => this.key(event));
    element.replaceChildren(this.root);
    channel.onmessage = (message, data) => this.receive(message, data);
  }

  close() {
    this.channel.onmessage = () => {};
    for (const pane of this.panes.values()) pane.close();
    this.panes.clear();
    this.panel.close();
    for (const { refused } of this.asked.values()) refused(new Error("the viewer was closed"));
    this.root.remove();
  }

  /** Undo and redo wherever the focus is, except in fields with their own. */
  key(event) {
    const key = event.key.toLowerCase();
    if (!(event.ctrlKey || event.metaKey) || !["z", "y"].includes(key) || event.target.matches("input[type=number], textarea")) return;
    event.preventDefault();
    event.stopPropagation();
    this.ask(key === "y" || event.shiftKey ? "redo" : "undo");
  }

  togglePanel() {
    const hidden = this.inner.classList.toggle("clvol-alone");
    this.hide.setAttribute("aria-expanded", String(!hidden));
  }

  paneName(name) {
    return (this.info?.volume?.space === "LPS" ? PATIENT_PANES : PANE_NAMES)[name];
  }

  // From the session

  receive(message, data) {
    if (message.type === "frame") this.frame(message, data);
    else if (message.type === "info") this.tell(message);
    else if (message.type === "state") this.take(message);
    else if (message.type === "stats") this.panel.stats({ ...message, picture: this.picture });
    else if (message.type === "status") this.report(message);
    else if (message.type === "reply") this.reply(message, data);
    else if (message.type === "overlay") this.overlay(message);
    else if (message.type === "joint") this.panel.joint.tell(message);
    else if (message.type === "wiper") this.compared(message.errors);
  }

  tell(info) {
    this.info = info;
    if (this.onLink && info.title) document.title = `${info.title} · clvol`;
    this.panel.tell(info);
    if (this.state) this.show();
  }

  take(message) {
    this.state = message.state;
    this.confirmed = structuredClone(message.state);
    this.unheard = this.unheard.filter(({ number }) => !(number <= message.heard));
    for (const { changes, whole } of this.unheard) this.apply(changes, whole);
    this.canUndo = message.can_undo;
    this.canRedo = message.can_redo;
    this.effective = message.effective ?? this.effective;
    this.show();
  }

  overlay(message) {
    this.overlays.set(message.pane, message);
    this.panes.get(message.pane)?.decorate(message);
  }

  /** The measured errors of the two filters. */
  compared(errors) {
    this.errors = errors;
    this.panel.tellErrors(errors);
    this.show();
  }

  show() {
    if (!this.state || !this.info) return;
    this.arrange();
    this.panel.show(this.state);
    for (const pane of this.panes.values()) {
      pane.wiper.show(this.state, this.effective.filter, this.errors?.filters);
      pane.element.classList.toggle("clvol-active", this.panes.size > 1 && pane.name === this.state.active);
    }
  }

  /** The panes of the layout; those that stay keep their pictures. */
  arrange() {
    const { layout, active } = this.state;
    const wanted = layout === "slice" ? [active === "3d" ? "z" : active] : PANES[layout];
    if (same([...this.panes.keys()], wanted)) return;
    for (const [name, pane] of this.panes) {
      if (wanted.includes(name)) continue;
      pane.close();
      this.panes.delete(name);
    }
    const panes = wanted.map((name) => [name, this.panes.get(name) ?? new Pane(this, name)]);
    this.panes = new Map(panes);
    this.grid.dataset.layout = layout;
    this.grid.replaceChildren(...panes.map(([, pane]) => pane.element));
    for (const [name, pane] of panes) pane.decorate(this.overlays.get(name));
    for (const [name, pane] of panes) pane.element.setAttribute("aria-label", `${this.info.title ?? "volume"}, ${this.paneName(name)}`);
  }

  frame(message, data) {
    if (this.line.textContent === WAITING) this.status(""); // in notebooks no connection clears it
    const pane = this.panes.get(message.pane ?? "3d");
    if (!pane || !data) return this.channel.send({ type: "ack", frame: message.number });
    const step = message.step ? `, step ${short(message.step, 3)}` : "";
    this.picture = `${message.width} × ${message.height}${step}, ${short(1000 * (message.seconds ?? 0), 3)} ms${message.final ? ", final" : ""}`;
    return pane.take(message, data);
  }

  status(text, kind = "info") {
    this.line.textContent = text ?? "";
    this.line.dataset.kind = kind;
  }

  /** A status of the session; after an error, which may concern a change made here, its last state is shown. */
  report({ text, kind }) {
    this.status(text, kind);
    if (kind !== "error" || !this.confirmed) return;
    this.unheard = [];
    this.state = structuredClone(this.confirmed);
    this.show();
  }

  // To the session

  /** Changes fields of the state by dotted names; changes while a control moves are `live`: one step of undo. */
  set(changes, live = false) {
    if (!this.state) return;
    this.apply(changes);
    this.tellSet({ changes, live, gesture: `panel-${this.gesture}` });
    if (!live) this.gesture += 1;
    this.show();
  }

  /** Sends the whole state to a session that does not have it. */
  setAll() {
    this.unheard = [];
    if (this.state) this.tellSet({ changes: structuredClone(this.state), whole: true });
  }

  tellSet({ changes, whole, ...more }) {
    this.lastSet += 1;
    this.unheard.push({ number: this.lastSet, changes, whole });
    this.channel.send({ type: "set", changes, whole, number: this.lastSet, ...more });
  }

  /** Applies changes to the state shown here. */
  apply(changes, whole = false) {
    if (whole) {
      this.state = structuredClone(changes);
      return;
    }
    if ("mode" in changes && changes.mode !== this.state.mode) this.state.options = {};
    for (const [name, value] of Object.entries(changes)) {
      const words = name.split(".");
      let part = this.state;
      for (const word of words.slice(0, -1)) part = part[word] ??= {};
      part[words.at(-1)] = value;
    }
  }

  /** Ends live changes: the next one is a new step of undo. */
  settle() {
    this.channel.send({ type: "set", changes: {}, gesture: `panel-${this.gesture++}` });
  }

  /** Sends a request; the promise is of {message, data}. */
  ask(what, more = {}) {
    const id = ++this.lastId;
    const answer = new Promise((answered, refused) => this.asked.set(id, { answered, refused }));
    this.channel.send({ type: "do", what, id, ...more });
    answer.catch((error) => this.status(error.message, "error"));
    return answer;
  }

  reply(message, data) {
    if (message.what === "pick") return this.picked(message);
    const waiting = this.asked.get(message.id);
    this.asked.delete(message.id);
    if (!waiting) return;
    if (message.error) waiting.refused(new Error(message.error));
    else waiting.answered({ message, data });
  }

  /** Shows what was picked. */
  picked({ position, value, steepness, units, label }) {
    if (!position) return this.status("nothing under the pointer");
    const parts = [`(${position.map((c) => short(c, 5)).join(", ")}) ${units}`.trim(), `value ${short(value, 6)}${label ? `, ${label}` : ""}`];
    if (steepness !== undefined) parts.push(`gradient ${short(steepness)}${units ? ` per ${units}` : ""}`);
    return this.status(parts.join(" · "));
  }

  async copy(what, name) {
    const answer = await this.ask(what).catch(() => null); // the error is shown already
    if (!answer) return;
    const { message } = answer;
    let { text = message.url ?? "" } = message;
    if (what === "copy_url" && this.onLink) text = this.onLink(text);
    const copied = await toClipboard(text);
    const box = this.panel.text;
    Object.assign(box, { hidden: copied, value: text });
    if (!copied) box.select();
    this.status(copied ? `copied as ${name}` : "no access to the clipboard: copy the selected text", copied ? "info" : "error");
  }

  async save(what, more = {}) {
    this.status(what === "movie" ? "drawing the movie" : "drawing the picture", "busy");
    const answer = await this.ask(what, more).catch(() => null); // the error is shown already
    if (!answer) return undefined;
    const { message, data } = answer;
    if (!data) return this.status(message.text ?? "no result", "error");
    const kind = { mp4: "video/mp4", webm: "video/webm", zip: "application/zip" }[message.format] ?? `image/${message.format ?? "png"}`;
    const name = message.name ?? `${(this.info.title ?? "clvol").replace(/[^\w.-]+/g, "-")}.${kind.split("/")[1]}`;
    return this.download(new Blob([data], { type: kind }), name);
  }

  download(blob, name) {
    const url = URL.createObjectURL(blob);
    make("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
    this.status(`saved as ${name}`);
  }
}

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
  let last = "";
  const channel = { send: (object) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(object)), onmessage: () => {} };
  const viewer = mount(element, channel, { onLink: (text) => new URL(text.slice(text.indexOf("#")), location.href).href });
  const wanted = () => new URLSearchParams(location.hash.slice(1)).get("s");

  /** Sends the state of the page's address. */
  const restore = () => {
    const text = wanted();
    if (!text || text === last) return;
    last = text;
    try {
      const bytes = Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0));
      channel.send({ type: "set", changes: JSON.parse(new TextDecoder().decode(bytes)), whole: true });
    } catch {
      viewer.status("the state in this page's address cannot be read; it may be incomplete", "error");
    }
  };

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
      last = "";
      if (viewer.state) viewer.setAll(); // from before the connection was lost
      else restore();
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
  addEventListener("hashchange", restore);
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
