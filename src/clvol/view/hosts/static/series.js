// -- volumes along time: playing them, and the curve of one place ----------------------------------------------------------

const RATES = [1, 2, 5, 10, 15, 20, 25, 30]; // volumes a second
const RATE = 10;
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
    this.element = make("div", { class: "clvol-buttons" }, this.button, this.rate, this.note);
    this.element.hidden = true;
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
