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
      labels: make("g", {}),
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
    const tops = this.tops(this.viewer.info?.histogram?.counts ?? []);
    parts.bars.setAttribute("d", this.bars(edges, tops));
    this.drawLabels(edges, tops);
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

  /** Where each bar ends. */
  tops(counts) {
    const heights = counts.map((n) => (this.log ? Math.log1p(n) : n));
    const sorted = [...heights].sort((a, b) => b - a);
    const top = (this.log ? sorted[0] : sorted[Math.min(2, sorted.length - 1)]) || 1; // the bar of the background may be cut off
    return heights.map((n) => GRAPH.height - (GRAPH.height - 8) * Math.min(n / top, 1));
  }

  bars(edges, tops) {
    const steps = tops.map((y, i) => `H${this.x(edges[i]).toFixed(1)}V${y.toFixed(1)}`);
    return `M8 ${GRAPH.height}${steps.join("")}H${this.x(edges.at(-1)).toFixed(1)}V${GRAPH.height}Z`;
  }

  /** Of labels each bar has the colour of its label, down into the strip: between them there is none. */
  drawLabels(edges, tops) {
    const { labels, colors } = this.viewer.info?.histogram ?? {};
    for (const part of [this.parts.area, this.parts.strip]) part.style.display = labels ? "none" : "";
    const bar = (label, i) => {
      const [left, right] = [this.x(edges[i]), this.x(edges[i + 1])];
      const d = `M${left} ${tops[i]}H${right}V${GRAPH.height}H${left}ZM${left} ${GRAPH.height + 4}H${right}v${GRAPH.strip}H${left}Z`;
      return label === null ? null : make("path", { d, fill: hex(this.colorOf(label, colors[i])), "data-label": label });
    };
    this.parts.labels.replaceChildren(...(labels ?? []).map(bar).filter(Boolean));
  }

  /** The colour of a label: of the points, if there are some, for more labels its own. */
  colorOf(label, own) {
    return this.points.length ? this.between(label)[0] : (this.viewer.state?.label_colors[label] ?? own);
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
