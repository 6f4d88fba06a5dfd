// -- volumes along time: playing them, and the curve of one place ----------------------------------------------------------

const RATES = [1, 2, 5, 10, 15, 20, 25, 30]; // volumes a second
const RATE = 10;
const PLOTTED = [280, 90]; // width and height of the curve, in its own units
const COUNTED = 12; // steps by which the rate is measured that is reached

/** Shows one volume after the other along an axis, and begins again after the last. The next one waits for all panes to show the last. */
class Series {
  constructor(viewer) {
    this.viewer = viewer;
    this.about = null; // of the axis
    this.playing = false;
    this.times = []; // of the last steps
    this.pending = new Set(); // panes that do not show the last step yet
    this.button = button("Play", () => (this.playing ? this.stop() : this.play()), { title: "show one after the other" });
    this.rate = make("select", { "aria-label": "volumes a second", title: "volumes a second", onchange: () => this.tellRate() });
    this.rate.append(...RATES.map((rate) => new Option(`${rate} a second`, rate, rate === RATE, rate === RATE)));
    this.note = make("span", { class: "clvol-note" });
    this.plot = make("svg", { class: "clvol-series", viewBox: `0 0 ${PLOTTED.join(" ")}`, role: "img", preserveAspectRatio: "none" });
    this.plot.addEventListener("pointerdown", (event) => this.seek(event));
    this.caption = make("p", { class: "clvol-note" });
    const more = make("details", { class: "clvol-more" }, make("summary", {}, "Values at the crosshair"), this.plot, this.caption);
    more.addEventListener("toggle", () => this.listen(more.open));
    this.more = more;
    const bar = make("div", { class: "clvol-buttons" }, this.button, this.rate, this.note);
    this.element = make("div", {}, bar, more);
    this.element.hidden = true;
    this.curve = null; // the session's message
  }

  close() {
    clearTimeout(this.next);
    this.playing = false;
  }

  tell({ axes = [] }) {
    this.about = axes.find((about) => about.plays) ?? null;
    this.element.hidden = !this.about;
    if (!this.about) this.close();
    else this.tellRate();
  }

  /** Has the session send the curve, or no longer. */
  listen(on) {
    this.viewer.ask("curve", { on }).catch(() => {}); // the error is shown
  }

  /** A session that has just begun does not know that the curve is wanted. */
  begin() {
    if (this.more.open) this.listen(true);
  }

  tellCurve(curve) {
    this.curve = curve;
    this.draw();
  }

  /** The curve, with a line at the place that is shown. */
  draw() {
    const { curve } = this;
    if (!curve || !this.about || !this.viewer.state) return;
    const values = curve.values ?? [];
    const known = values.filter((value) => value !== null);
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const [width, height] = PLOTTED;
    const x = (at) => (values.length > 1 ? 4 + ((width - 8) * at) / (values.length - 1) : width / 2);
    const y = (value) => (high > low ? height - 5 - ((height - 10) * (value - low)) / (high - low) : height / 2);
    const line = values.map((value, at) => (value === null ? "" : `${at && values[at - 1] !== null ? "L" : "M"}${x(at).toFixed(2)} ${y(value).toFixed(2)}`));
    const here = make("line", { class: "clvol-here", x1: x(this.place), x2: x(this.place), y1: 0, y2: height });
    this.plot.replaceChildren(here, make("path", { class: "clvol-curve", d: line.join("") }));
    const value = values[this.place];
    const where = curve.position ? ` at (${curve.position.map((c) => short(c, 4)).join(", ")})` : "";
    const { axis, seconds } = this.about;
    const when = `${axis} ${this.place}${seconds ? ` (${short(this.place * seconds, 4)} s)` : ""}`;
    const text = curve.problem ?? `${when}: ${short(value, 5)}; from ${short(low)} to ${short(high)}${where}`;
    this.caption.textContent = text;
    this.plot.setAttribute("aria-label", `values along ${axis}; ${text}`);
  }

  /** Shows the volume whose value was clicked. */
  seek(event) {
    const show = (other, live) => {
      const { left, width } = this.plot.getBoundingClientRect();
      const share = ((other.clientX - left) / width) * PLOTTED[0];
      const at = Math.round(((share - 4) / (PLOTTED[0] - 8)) * (this.about.count - 1));
      this.viewer.set({ [`index.${this.about.axis}`]: clamp(at, 0, this.about.count - 1) }, live);
    };
    drag(event, this.plot, (other) => show(other, true), (other) => show(other, false));
    show(event, true);
  }

  get place() {
    return this.viewer.state.index[this.about.axis] ?? 0;
  }

  play() {
    this.playing = true;
    this.times = [];
    this.button.textContent = "Pause";
    this.step();
  }

  /** Ends it; what was played is one step of undo. */
  stop() {
    if (!this.playing) return;
    this.close();
    this.button.textContent = "Play";
    this.viewer.settle();
    this.tellRate();
  }

  step() {
    this.began = performance.now();
    this.times = [...this.times, this.began].slice(-COUNTED);
    this.pending = new Set(this.viewer.panes.keys());
    this.viewer.set({ [`index.${this.about.axis}`]: (this.place + 1) % this.about.count }, true);
    this.number = this.viewer.lastSet;
    this.tellRate();
  }

  /** A pane shows a frame: of the last step, if the session had heard of that before. */
  shown({ pane, few, heard }) {
    if (!this.playing || few || !(heard >= this.number) || !this.pending.delete(pane) || this.pending.size) return;
    this.next = setTimeout(() => this.step(), Math.max(0, this.began + 1000 / this.rate.value - performance.now()));
  }

  /** The seconds of all, and while it plays what is reached. */
  tellRate() {
    const [first, last] = [this.times[0], this.times.at(-1)];
    const reached = this.playing && this.times.length > 2 ? `, ${short((1000 * (this.times.length - 1)) / (last - first), 2)} a second reached` : "";
    this.note.textContent = `${this.about.count} in ${short(this.about.count / this.rate.value, 3)} s${reached}`;
  }
}
