// -- layers: the media that are shown together ---------------------------------------------------------------------

/** A row each: whether it is seen and, beside the first, which the panel edits, its opacity, colours, window, and a button that removes it. */
class Layers {
  constructor(viewer) {
    this.viewer = viewer;
    this.about = [];
    this.rows = [];
    this.list = make("ul", { class: "clvol-layers", "aria-label": "layers" });
    this.opening = viewer.opens ? new Opening(viewer) : null;
    this.element = section("Layers", true, this.list);
    this.element.hidden = true;
  }

  close() {
    this.opening?.close();
  }

  tell({ media = [], colormaps = [] }) {
    this.element.hidden = media.length < 2;
    if (same(media, this.about)) return;
    this.about = media;
    this.rows = media.map((about, k) => this.rowOf(about, k, colormaps));
    this.list.replaceChildren(...this.rows.map((row) => row.element));
  }

  rowOf({ name, edited }, k, colormaps) {
    const eye = toggle(name, (on) => this.put(k, { visible: on }), "whether it is seen");
    const gone = button("\u00d7", () => this.viewer.ask("remove_layer", { layer: k }), { label: `remove ${name}` });
    const head = make("div", { class: "clvol-layer" }, eye.element, k ? gone : null);
    if (!edited) return { element: make("li", {}, head), controls: { visible: eye } };
    const opacity = slider("Opacity", { low: 0, high: 1 }, (value, live) => this.put(k, { opacity: Math.max(0, value) }, live), `of ${name}`);
    const cmap = choice("Colours", (value) => this.put(k, { cmap: value || null }), `of ${name}`);
    cmap.fill([["", "as given"], ...colormaps]);
    const window = spanBox("Window", (ends) => this.put(k, { window: ends }), `the values of ${name} that are told apart`);
    const body = make("details", { class: "clvol-more" }, make("summary", {}, "Colours, window"), cmap.element, window.element);
    return { element: make("li", {}, head, opacity.element, body), controls: { visible: eye, opacity, cmap, window } };
  }

  put(k, change, live = false) {
    const media = this.about.map((_, i) => ({ ...(this.viewer.state.media[i] ?? {}) }));
    Object.assign(media[k], change);
    this.viewer.set({ media }, live);
  }

  show({ media }) {
    this.rows.forEach(({ controls }, k) => {
      for (const [word, control] of Object.entries(controls)) control.show(media[k]?.[word] ?? this.about[k][word] ?? (word === "opacity" ? 1 : null));
    });
  }
}
