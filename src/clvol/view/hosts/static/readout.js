// -- what lies under the pointer: a line at the pane's edge ---------------------------------------------------------

const ASKED = 100; // milliseconds between two questions

class Readout {
  constructor(pane) {
    this.pane = pane;
    this.element = make("div", { class: "clvol-readout", "aria-hidden": "true" });
    this.due = 0; // handle of the next question
    this.last = -Infinity;
    this.over = null;
  }

  close() {
    clearTimeout(this.due);
  }

  /** Asks the session what lies there, but not more often than one reads; without a place the pointer has left. */
  at(place) {
    this.over = place;
    if (!place) return this.ask();
    if (!this.due) this.due = setTimeout(() => this.ask(), Math.max(0, this.last + ASKED - performance.now()));
  }

  ask() {
    clearTimeout(this.due);
    this.due = 0;
    this.last = performance.now();
    const { over, pane } = this;
    pane.viewer.channel.send(over ? { type: "hover", pane: pane.name, x: over.x, y: over.y } : { type: "hover" });
    if (!over) this.show(null);
  }

  /** `found`: the session's message "readout", or nothing. */
  show(found) {
    if (!found?.position || !this.over) return this.element.replaceChildren();
    const { position, voxel, units, values } = found;
    const shown = values.map(({ name, value, label }) => {
      const text = value === null ? NOTHING : [short(value, 6), label].filter(Boolean).join(" ");
      return values.length > 1 ? `${name} ${text}` : text;
    });
    const place = `${position.map((c) => short(c, 5)).join(", ")} ${units}`.trim();
    this.element.replaceChildren(...[...shown, `voxel ${voxel.join(", ")}`, place].map((text) => make("span", {}, text)));
  }
}
