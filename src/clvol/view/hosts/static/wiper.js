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
