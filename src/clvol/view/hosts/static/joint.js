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
