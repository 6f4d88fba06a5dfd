// -- measures on slices: lines over the pictures, and a list in the panel --------------------------------------------

const MEASURES = { distance: "distance", angle: "angle", area: "area", rectangle: "rectangle", ellipse: "ellipse" };
const ROOMY = 260; // CSS pixels of a pane in which marks have more than their numbers
const LETTER = 7.5; // CSS pixels, at most

/** What a row of the session's message "measures" says, in a few words. */
function measureWords(row, units) {
  if (!row) return "";
  if (row.length !== undefined) return `${short(row.length)} ${units}`.trim();
  if (row.angle !== undefined) return `${short(row.angle)}\u00b0`;
  if (row.area === undefined) return "";
  return `${short(row.area)}${units ? ` ${units}\u00b2` : ""}`;
}

/** The path of a mark; its points are in CSS pixels. */
function markPath(kind, points) {
  const line = points.map((p) => p.join(" ")).join("L");
  if (points.length === 1) return `M${line}h0.01`;
  if (kind === "area" && points.length > 2) return `M${line}Z`;
  if (points.length < 3 || !["rectangle", "ellipse"].includes(kind)) return `M${line}`;
  const [a, b, c] = points;
  const d = [b[0] + c[0] - a[0], b[1] + c[1] - a[1]];
  if (kind === "rectangle") return `M${[a, b, d, c].map((p) => p.join(" ")).join("L")}Z`;
  const [rx, ry] = [Math.hypot(b[0] - a[0], b[1] - a[1]) / 2, Math.hypot(c[0] - a[0], c[1] - a[1]) / 2];
  const ends = [[(a[0] + c[0]) / 2, (a[1] + c[1]) / 2], [(b[0] + d[0]) / 2, (b[1] + d[1]) / 2]];
  return `M${ends[0].join(" ")}A${rx} ${ry} 0 1 1 ${ends[1].join(" ")}A${rx} ${ry} 0 1 1 ${ends[0].join(" ")}`;
}

/** Elements of SVG for the marks of a pane, each with its number and, where there is room, what it measures. */
function drawnMarks(marks, measures, width) {
  return marks.flatMap(({ number, kind, points }) => {
    const path = markPath(kind, points);
    const [x, y] = points.reduce((best, p) => (p[0] > best[0] ? p : best));
    const row = measures.rows[number];
    const said = row?.kind === kind && width >= ROOMY ? measureWords(row, measures.units) : "";
    const words = `${number + 1}${said ? `: ${said}` : ""}`;
    const left = Math.min(x + 6, width - LETTER * words.length);
    const text = make("text", { class: "clvol-measured", x: left, y: y - 6 }, words);
    return [make("path", { class: "clvol-mark-edge", d: path }), make("path", { class: "clvol-mark", d: path }), text];
  });
}

class Measures {
  constructor(viewer) {
    this.viewer = viewer;
    this.rows = [];
    this.units = "";
    this.tool = choice("Draw", (value) => this.draw(value), "drag, or click point after point; a click on an end closes an area");
    this.tool.fill([["", "nothing"], ...Object.entries(MEASURES)]);
    this.list = make("ol", { class: "clvol-measures", "aria-label": "measures" });
    this.saved = button("Save as CSV", () => this.save(), { title: "all numbers as a table" });
    this.cleared = button("Remove all", () => viewer.set({ marks: [] }));
    this.element = section("Measures", false, this.tool.element, this.list, make("div", { class: "clvol-buttons" }, this.saved, this.cleared));
  }

  /** Chooses a tool; where no slice is seen, one is shown. */
  draw(tool) {
    const { state } = this.viewer;
    this.viewer.set({ tool: tool || null, ...(tool && state.layout === "3d" ? { layout: "slice", active: "z" } : {}) });
  }

  /** The session's message. */
  tell({ rows, units }) {
    Object.assign(this, { rows, units });
    this.show(this.viewer.state);
  }

  show({ marks, tool }) {
    this.tool.show(tool in MEASURES ? tool : "");
    this.saved.disabled = this.cleared.disabled = !marks.length;
    this.list.replaceChildren(...marks.map((mark, k) => this.rowOf(mark, k)));
  }

  rowOf({ kind }, k) {
    const row = this.rows[k]?.kind === kind ? this.rows[k] : {};
    const words = [kind, measureWords(row, this.units)];
    if (row.mean !== undefined) words.push(`mean ${short(row.mean)}, sd ${short(row.sd, 3)}, ${short(row.min)} to ${short(row.max)}, n ${row.count}`);
    const gone = button("\u00d7", () => this.viewer.set({ marks: this.viewer.state.marks.filter((_, i) => i !== k) }), { label: `remove measure ${k + 1}` });
    return make("li", {}, make("span", {}, words.filter(Boolean).join(" \u00b7 ")), gone);
  }

  async save() {
    const answer = await this.viewer.ask("measures_csv").catch(() => null); // the error is shown already
    if (answer) this.viewer.download(new Blob([answer.message.text], { type: "text/csv" }), `${this.viewer.info.stem}-measures.csv`);
  }
}
