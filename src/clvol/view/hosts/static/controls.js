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
const FAR = 9999; // CSS pixels: past the edge of any pane
const NOTHING = "\u2013";
const HINT = "drag to turn, wheel to zoom; ? lists all keys";
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
  const svg = ["svg", "g", "path", "line", "circle", "polygon", "rect", "text", "title", "defs", "image", "linearGradient", "stop"].includes(tag);
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

/** Two numbers, from and to, of a window, which is (center, width); emptied, null: as given. */
function spanBox(label, changed, hint) {
  const told = () => {
    const [low, high] = boxes.map((box) => (box.value === "" ? NaN : Number(box.value)));
    if (boxes.every((box) => box.value === "")) changed(null);
    else if (low < high) changed([low / 2 + high / 2, high - low]);
  };
  const boxes = ["from", "to"].map((word) => make("input", { type: "number", step: "any", "aria-label": `${label} ${word}`, onchange: told }));
  return {
    element: make("div", { class: "clvol-row clvol-span-row", title: hint }, make("span", {}, label), ...boxes),
    show(window) {
      if (!window || boxes.includes(document.activeElement)) return;
      const [center, width] = window;
      [center - width / 2, center + width / 2].forEach((end, i) => (boxes[i].value = short(end, 5)));
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
