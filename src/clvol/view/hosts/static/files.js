// -- files that are being made ---------------------------------------------------------------------------------------------

const KINDS = { mp4: "video/mp4", webm: "video/webm", zip: "application/zip", ply: "model/ply", stl: "model/stl", obj: "model/obj", glb: "model/gltf-binary" };
const LARGEST = 8192; // pixels along an edge that the session draws

/** What can be saved, and a row for each file that the session is making: how far it is, and a button that gives it up. */
class Files {
  constructor(viewer) {
    this.viewer = viewer;
    this.rows = new Map(); // by the id of the request
    const list = (label, ...options) => make("select", { "aria-label": label }, ...options.map(([text, value]) => new Option(text, value)));
    const size = list("size of the picture", ["as shown", 1], ["2 × as large", 2], ["4 × as large", 4]);
    const marks = toggle("with measures", () => {}, "with those on a slice");
    marks.show(true);
    const movie = list("movie format", ["GIF", "gif"], ["MP4", "mp4"], ["WebM", "webm"], ["WebP", "webp"], ["PNGs in a zip", "zip"]);
    const mesh = list("mesh format", ["PLY", "ply"], ["STL", "stl"], ["OBJ", "obj"], ["glTF", "glb"]);
    const faces = list("number of triangles", ["all triangles", ""], ["1,000,000", 1e6], ["100,000", 1e5], ["10,000", 1e4]);
    const row = (text, title, pressed, ...lists) => make("div", { class: "clvol-buttons" }, button(text, pressed, { title }), ...lists);
    this.list = make("ul", { class: "clvol-files", "aria-label": "files that are being made" });
    this.element = make(
      "div",
      {},
      row("Save picture", "the final picture, lossless", () => viewer.save("save_picture", { ...this.larger(Number(size.value)), measures: marks.box.checked }), size, marks.element),
      row("Save movie", "one turn", () => viewer.save("movie", { format: movie.value }), movie),
      row("Save mesh", "the isosurface, or the surfaces of labels", () => viewer.save("mesh", { format: mesh.value, ...(faces.value && { faces: Number(faces.value) }) }), mesh, faces),
      this.list,
    );
  }

  /** Width and height of the active pane's picture, so many times as large. */
  larger(times) {
    const { state, panes } = this.viewer;
    const { canvas } = panes.get(state.active) ?? [...panes.values()][0];
    const scale = Math.min(times, LARGEST / Math.max(canvas.width, canvas.height));
    return times === 1 ? {} : { width: Math.round(canvas.width * scale), height: Math.round(canvas.height * scale) };
  }

  /** How far a file is. */
  tell({ id, name, doing, share }) {
    if (!this.rows.has(id)) this.rows.set(id, this.rowOf(id, name, doing));
    if (share) this.rows.get(id).bar.value = share;
  }

  rowOf(id, name, doing) {
    const bar = make("progress", { max: 1, "aria-label": name });
    const cancel = button("Cancel", () => this.viewer.ask("cancel", { file: id }).catch(() => {}), { label: `cancel ${name}` }); // the error is shown
    const element = make("li", {}, make("span", { title: name }, doing), bar, cancel);
    this.list.append(element);
    return { element, bar };
  }

  /** A file is ready, or will not come. */
  end(id) {
    this.rows.get(id)?.element.remove();
    this.rows.delete(id);
  }

  /** The session has ended, and with it what it was making. */
  clear() {
    for (const id of [...this.rows.keys()]) this.end(id);
  }
}
