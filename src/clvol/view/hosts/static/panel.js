// -- the panel ---------------------------------------------------------------------------------------------------

const LIGHTS = {
  automatic: null,
  headlight: [{ direction: null }],
  "from the left": [{ direction: [-0.8, 0.4, 0.6], frame: "camera" }],
  "from the right": [{ direction: [0.8, 0.4, 0.6], frame: "camera" }],
  "from above": [{ direction: [0, 0.95, 0.4], frame: "camera" }],
};
/** What stands around the picture, by its word: the label and a hint. */
const AROUND = {
  color_bar: ["Colour bar", "the transfer function's colours with their values"],
  scale_bar: ["Scale bar", "true at the depth of what the camera looks at"],
  axes: ["Axes", "ticks with the world's coordinates"],
  box: ["Box", "the edges around the volume"],
  letters: ["Letters", "the sides of the patient"],
  cube: ["Cube", "is turned like the world"],
};
const MATERIAL = { ambient: [0, 1, 0.25], diffuse: [0, 1.5, 0.75], specular: [0, 1, 0.2], shininess: [1, 120, 30] };
/** How dark it is where matter stops light, by its word: the label and a hint. */
const DARK = {
  shadow: ["Shadow", "of lights, which then stand still while the camera moves"],
  occlusion: ["Occlusion", "of light from all around"],
};
const ADVANCED = ["termination", "virtual", "tolerance", "method"];
const TOOL_HINT = "what the first button drags";
const EDITED = "\u0000edited";
const LOOKED_FOR = 12; // labels from which there is a search field
const LISTED = 200; // channels that are listed; more have a slider
const TYPED = 150; // milliseconds without typing before a search

/** Which labels of a label map are seen: a row for each of the first that match the filter; the session searches. */
class Labels {
  constructor(viewer) {
    this.viewer = viewer;
    this.listed = null; // labels of the volume that the session sent first
    this.boxes = new Map(); // the controls of a row, by number
    this.filter = make("input", { type: "search", placeholder: "name or number", "aria-label": "filter the labels", maxlength: 200 });
    this.filter.addEventListener("input", () => {
      clearTimeout(this.typing);
      this.typing = setTimeout(() => this.find(), TYPED);
    });
    const all = button("All", () => viewer.set({ labels: null }), { title: "show all labels" });
    const none = button("None", () => viewer.set({ labels: { shown: [] } }), { title: "hide all labels" });
    const given = button("Reset", () => viewer.set({ label_colors: {}, label_opacities: {} }), { title: "colours and opacities as given" });
    const head = make("div", { class: "clvol-buttons", role: "toolbar", "aria-label": "all labels" }, all, none, given, this.filter);
    this.list = make("ul", { class: "clvol-labels", "aria-label": "labels" });
    this.note = make("p", { class: "clvol-note", "aria-live": "polite" });
    this.element = section("Labels", true, head, this.list, this.note);
  }

  close() {
    clearTimeout(this.typing);
  }

  tell(info) {
    this.listed = info.labels ?? null;
    this.element.hidden = !this.listed;
    if (!this.listed) return;
    this.filter.hidden = this.listed.count <= LOOKED_FOR;
    if (this.filter.hidden) this.filter.value = "";
    this.fill(this.listed);
    if (this.filter.value) this.find();
  }

  /** Requests the labels that match the filter. */
  async find() {
    const words = this.filter.value;
    const answer = words ? await this.viewer.ask("labels", { words }).catch(() => null) : { message: this.listed }; // the error is shown already
    if (!answer || words !== this.filter.value) return; // the text has changed meanwhile
    this.fill(answer.message);
    this.show(this.viewer.state);
  }

  fill({ rows, count }) {
    this.found = count;
    this.boxes.clear();
    this.list.replaceChildren(...rows.map((label) => this.rowOf(label)));
  }

  rowOf([number, name, color, opacity]) {
    const box = make("input", { type: "checkbox", onchange: () => this.put(number, box.checked) });
    const words = name || String(number);
    const swatch = make("input", { type: "color", class: "clvol-swatch", "aria-label": `colour of ${words}` });
    const seen = make("input", { type: "range", min: 0, max: 1, step: 0.01, "aria-label": `opacity of ${words}`, title: "opacity" });
    for (const [event, live] of [["input", true], ["change", false]]) {
      swatch.addEventListener(event, () => this.look("label_colors", number, rgb(swatch.value), live));
      seen.addEventListener(event, () => this.look("label_opacities", number, Number(seen.value), live));
    }
    this.boxes.set(number, { box, swatch, seen, color, opacity });
    const text = make("span", { title: name ? `${name}: label ${number}` : null }, words);
    const only = button("Only", () => this.viewer.set({ labels: { shown: [number] } }), { label: `show only ${words}` });
    return make("li", {}, make("label", { class: "clvol-check" }, box, text), swatch, seen, only);
  }

  /** Changes the colour or the opacity of a label; what else gives labels their colours goes. */
  look(word, number, value, live) {
    const changed = { ...this.viewer.state[word], [number]: value };
    this.viewer.set({ transfer: null, preset: null, window: null, cmap: null, [word]: changed }, live);
  }

  /** Shows or hides one label. */
  put(number, on) {
    const { labels } = this.viewer.state;
    const what = labels?.shown ? "shown" : "hidden";
    const rest = (labels?.[what] ?? []).filter((one) => one !== number);
    const made = on === (what === "shown") ? [...rest, number] : rest;
    this.viewer.set({ labels: what === "hidden" && !made.length ? null : { [what]: made } });
  }

  show({ labels, label_colors: colors, label_opacities: opacities }) {
    if (!this.listed) return;
    const chosen = new Set(labels?.shown ?? labels?.hidden ?? []);
    for (const [number, { box, swatch, seen, color, opacity }] of this.boxes) {
      box.checked = chosen.has(number) === Boolean(labels?.shown);
      swatch.value = hex(colors[number] ?? color);
      if (!seen.matches(":active")) seen.value = opacities[number] ?? opacity; // not while it is held
    }
    const { count } = this.listed;
    const seen = labels?.shown ? chosen.size : Math.max(count - chosen.size, 0);
    const [listed, some] = [this.boxes.size, this.filter.value ? "of these" : "of them"];
    const found = this.filter.value ? `; ${this.found} found` : "";
    this.note.textContent = `${seen} of ${count} shown${found}${listed < this.found ? `; the first ${listed} ${some} are listed` : ""}`;
  }
}

/** Which of several volumes on one grid is shown: a list or a slider for each leading axis. */
class Axes {
  constructor(viewer) {
    this.viewer = viewer;
    this.about = [];
    this.controls = [];
    this.body = make("div", {});
    this.series = new Series(viewer);
    this.element = section("Volumes", true, this.body, this.series.element);
    this.element.hidden = true;
  }

  tell({ axes = [] }) {
    this.element.hidden = !axes.length;
    this.series.tell({ axes });
    if (same(axes, this.about)) return; // do not replace a slider that is held
    this.about = axes;
    this.controls = axes.map((about) => this.controlOf(about));
    this.body.replaceChildren(...this.controls.map((control) => control.element));
  }

  controlOf({ axis, count, names, first }) {
    const put = (value, live = false) => this.viewer.set({ [`index.${axis}`]: value }, live);
    const hint = `which ${axis} is shown`;
    if (!first && (axis === "channel" ? count > LISTED : names.length < count))
      return slider(axis, { low: 0, high: count - 1, step: 1 }, (value, live) => put(clamp(Math.round(value), 0, count - 1), live), hint);
    const control = choice(axis, (value) => put(value === first ? value : Number(value)), hint);
    const places = Array.from({ length: count }, (_, i) => [i, names[i] ?? i]);
    control.fill(first ? [[first, first], ...places] : places);
    return control;
  }

  show({ index }) {
    this.about.forEach(({ axis, first }, i) => this.controls[i].show(index[axis] ?? first));
    this.series.draw();
  }
}

class Panel {
  constructor(viewer) {
    this.viewer = viewer;
    this.options = make("div", { class: "clvol-options" });
    this.advanced = make("div", { class: "clvol-options" }); // those that trade time for accuracy
    this.transfer = new TransferEditor(viewer);
    this.joint = new JointEditor(viewer);
    this.axes = new Axes(viewer);
    this.files = new Files(viewer);
    this.layers = new Layers(viewer);
    this.measures = new Measures(viewer);
    this.labels = new Labels(viewer);
    this.made = null; // mode whose options are shown
    this.element = make("div", { class: "clvol-panel", role: "region", "aria-label": "settings" });
    this.element.append(
      this.toolbar(),
      this.axes.element,
      this.layers.element,
      this.labels.element,
      section("Look", true, this.lookControls()),
      section("Reconstruction", true, this.filterControls()),
      section("Advanced", false, make("div", {}, this.step.element, this.advanced)),
      section("Slices", false, this.sliceControls()),
      this.measures.element,
      section("Camera", false, this.cameraControls()),
      section("Light", false, this.lightControls()),
      section("Clip planes", false, this.cropControls()),
      section("Around the picture", false, this.aroundControls()),
      section("Share", true, this.shareControls()),
      section("Statistics", false, this.statisticsControls()),
    );
  }

  close() {
    this.axes.series.close();
    this.transfer.close();
    this.joint.close();
    this.labels.close();
    this.layers.close();
  }

  /** Sets one field as soon as a control changes. */
  setter(name, read = (value) => value) {
    return (value, live = false) => this.viewer.set({ [name]: read(value) }, live);
  }

  toolbar() {
    const { viewer } = this;
    this.undo = button("Undo", () => viewer.ask("undo"), { title: "undo (Ctrl+Z)" });
    this.redo = button("Redo", () => viewer.ask("redo"), { title: "redo (Ctrl+Shift+Z)" });
    const fit = button("Fit", () => viewer.ask("fit"), { title: "fit the view to the volume" });
    const reset = button("Reset", () => viewer.ask("reset"), { title: "back to the first state" });
    this.layout = choice("Layout", (value) => viewer.set(value === "slice" ? this.oneSlice() : { layout: value }));
    this.layout.fill([["3d", "3-D"], ["slice", "slice"], ["linked", "3-D and slices"]]);
    this.tool = choice("Drag", this.setter("tool", (value) => value || null), TOOL_HINT);
    this.tool.fill([["", "orbit, crosshair"], ["pan", "pan"], ["zoom", "zoom"], ["roll", "roll"], ["window", "window"], ["isovalue", "isovalue"], ["crop", "clip planes"]]);
    const bar = make("div", { class: "clvol-buttons", role: "toolbar", "aria-label": "history and view" }, this.undo, this.redo, fit, reset, this.layers.opening?.button);
    return make("div", { class: "clvol-head" }, bar, this.layers.opening?.box, this.layout.element, this.tool.element);
  }

  oneSlice() {
    const { active } = this.viewer.state;
    return { layout: "slice", active: active === "3d" ? "z" : active };
  }

  lookControls() {
    this.mode = choice("Mode", this.setter("mode"));
    this.preset = choice("Preset", (value) => {
      if (value !== EDITED) this.viewer.set({ transfer: null, preset: value || null, window: null, cmap: null, opacity: null });
    });
    this.cmap = choice("Colours", (value) => this.viewer.set({ transfer: null, cmap: value || null }), "colour map instead of the preset's colours");
    this.opacity = slider("Opacity ×", { low: 0, high: 4 }, this.setter("opacity"), "factor on all opacities of the preset");
    this.edges = slider("Edges", { low: 0, high: 1 }, this.setter("gradient_opacity"), "how much of the opacity is missing where values do not change");
    this.graded = toggle("By the gradient too", (on) => this.grade(on), "colours and opacities of boundaries, by value and gradient");
    const file = make("input", { type: "file", accept: ".json,application/json", "aria-label": "file of colours", hidden: true, onchange: () => this.load(file) });
    this.saved = button("Save colours", () => this.save(), { title: "colours and opacities as JSON" });
    const load = button("Load colours", () => file.click(), { title: "colours and opacities from JSON" });
    const files = make("div", { class: "clvol-buttons" }, this.saved, load, file);
    const edited = [this.transfer, this.joint, this.graded, this.cmap, this.opacity, this.edges].map((control) => control.element);
    return make("div", {}, this.mode.element, this.options, this.preset.element, ...edited, files);
  }

  /** A function of value and gradient in place of one of values, or that of the preset. */
  async grade(on) {
    const answer = on ? await this.viewer.ask("joint").catch(() => null) : null; // the error is shown already
    this.viewer.set({ transfer: answer?.message.transfer ?? null });
  }

  save() {
    this.viewer.download(new Blob([JSON.stringify(this.colored)], { type: "application/json" }), `${this.viewer.info.stem}-colours.json`);
  }

  async load(file) {
    const [chosen] = file.files;
    file.value = ""; // the same one may be chosen again
    if (!chosen) return;
    try {
      this.viewer.set({ transfer: JSON.parse(await chosen.text()) });
    } catch {
      this.viewer.status(`${chosen.name} is no JSON`, "error");
    }
  }

  filterControls() {
    this.filter = choice("Filter", this.setter("filter", (value) => value || null), "reconstruction filter between samples");
    this.boundary = choice("Boundary", this.setter("boundary"), "values outside the volume");
    this.step = slider("Step", { low: 0.1, high: 2, step: 0.05 }, this.setter("step"), "distance between samples along a ray, in voxels");
    this.compare = toggle("Compare with", (on) => this.viewer.set({ wiper: on ? { filter: this.other.list.value || "linear", at: 0.5 } : null }), "A/B: another filter to the right of a bar");
    this.other = choice("Other filter", (value) => this.viewer.state.wiper && this.viewer.set({ "wiper.filter": value }));
    this.errors = make("p", { class: "clvol-note", "aria-live": "polite" });
    return make("div", {}, this.filter.element, this.boundary.element, this.compare.element, this.other.element, this.errors);
  }

  sliceControls() {
    this.plane = choice("Slice", (value) => this.viewer.set({ active: value }));
    this.crosshair = ["x", "y", "z"].map((axis, i) =>
      slider(axis, { low: 0, high: 1 }, (value, live) => {
        const at = [...(this.viewer.state.crosshair ?? this.viewer.info.volume.center)];
        at[i] = value;
        this.viewer.set({ crosshair: at }, live);
      }),
    );
    const windowed = (i) => (value, live) => {
      const pair = [...this.sliceWindow()];
      pair[i] = value;
      this.viewer.set({ "slice.window": value === null ? null : pair }, live);
    };
    this.level = slider("Level", { low: 0, high: 1, open: true }, windowed(0), "the value in the middle of the greys of slices");
    this.width = slider("Window", { low: 0, high: 1, open: true }, windowed(1), "from black to white in slices");
    const given = button("As the picture", () => this.viewer.set({ "slice.window": null }), { title: "slices have no window of their own" });
    this.straight = button("Straight", () => this.viewer.set({ "slice.turn": null }), { title: "across the axes of the world again; Alt and a drag turn slices" });
    this.thickness = slider("Thickness", { low: 0, high: 1 }, this.setter("slice.thickness", (value) => Math.max(0, value)), "of a slab, in world units; 0 is the plane itself");
    this.projected = choice("Slab shows", this.setter("slice.project"), "of the values across a slab");
    this.contour = slider("Contours", { low: 0, high: 8, step: 1 }, this.setter("slice.contour"), "lines along the boundaries of labels, in pixels; 0 fills areas");
    this.alike = toggle("Same scale", this.setter("slice.alike"), "slices across all axes are equally magnified");
    const buttons = make("div", { class: "clvol-buttons" }, given, this.straight);
    const rows = [...this.crosshair, this.level, this.width, this.thickness, this.projected, this.contour, this.alike];
    return make("div", {}, this.plane.element, ...rows.map((c) => c.element), buttons);
  }

  /** Centre and width of the greys of slices. */
  sliceWindow() {
    return this.viewer.state.slice.window ?? this.viewer.effective.window ?? [0, 1];
  }

  cameraControls() {
    this.projection = choice("Projection", this.setter("camera.projection"));
    this.projection.fill(["perspective", "orthographic"]);
    this.style = choice("Orbit", this.setter("camera.style"), "about the vertical, or freely");
    this.style.fill(["turntable", "trackball"]);
    this.fov = slider("Angle of view", { low: 5, high: 100, step: 1 }, this.setter("camera.fov"));
    this.zoom = slider("Zoom (log₂)", { low: -3, high: 6 }, this.setter("camera.zoom", (value) => 2 ** clamp(value, -4, 9)));
    this.views = make("div", { class: "clvol-buttons", role: "toolbar", "aria-label": "views" });
    return make("div", {}, this.views, this.projection.element, this.style.element, this.fov.element, this.zoom.element);
  }

  lightControls() {
    this.light = choice("Lights", (name) => this.viewer.set({ lights: LIGHTS[name] ?? null }));
    this.light.fill(Object.keys(LIGHTS));
    this.material = Object.entries(MATERIAL).map(([name, [low, high]]) => [name, slider(name, { low, high }, this.setter(`material.${name}`))]);
    this.dark = Object.entries(DARK).map(([name, [label, hint]]) => [name, slider(label, { low: 0, high: 1 }, this.setter(name), hint)]);
    this.rays = toggle("Exact shadows", this.setter("shadow_rays"), "of exact surfaces, in memory: by rays to the lights");
    this.linear = toggle("Linear light", this.setter("linear_light"), "colours are computed in linear light");
    this.background = colorBox("Background", this.setter("background"));
    return make("div", {}, this.light.element, ...this.dark.map(([, c]) => c.element), this.rays.element, this.linear.element, ...this.material.map(([, c]) => c.element), this.background.element);
  }

  cropControls() {
    const hint = "six planes across the axes: drag their dots in the picture, or set them here";
    this.cropping = toggle("Crop to a box", (on) => this.viewer.set({ clip: on ? this.box() : null }), hint);
    this.crop = ["x", "y", "z"].flatMap((axis, i) =>
      ["low", "high"].map((side) => slider(`${axis} ${side === "low" ? "from" : "to"}`, { low: 0, high: 1 }, (value, live) => this.cropTo(i, side, value, live))),
    );
    return make("div", {}, this.cropping.element, ...this.crop.map((c) => c.element));
  }

  /** What stands around the picture at rest: furniture, by the words of `clvol.render`. */
  aroundControls() {
    const change = (name) => this.setter(`furniture.${name}`);
    const toggles = Object.entries(AROUND).map(([name, [label, hint]]) => [name, toggle(label, change(name), hint)]);
    const texts = [["title", textBox("Title", change("title"))], ["time_stamp", textBox("Time stamp", change("time_stamp"))]];
    this.around = [...toggles, ...texts];
    const theme = (name, color) => button(name, () => this.viewer.set({ background: color }), { title: `on ${name === "print" ? "white" : "black"}` });
    const themes = make("div", { class: "clvol-buttons" }, make("span", {}, "Theme"), theme("screen", [0, 0, 0]), theme("print", [1, 1, 1]));
    return make("div", {}, ...this.around.map(([, control]) => control.element), themes);
  }

  shareControls() {
    const { viewer } = this;
    const copy = (what, name) => button(name, () => viewer.copy(what, name), { title: `copy this picture as ${name}` });
    const buttons = [copy("copy_python", "Python"), copy("copy_toml", "TOML"), copy("copy_url", "URL")];
    this.text = make("textarea", { class: "clvol-text", readonly: true, rows: 4, hidden: true, "aria-label": "text to copy" });
    return make("div", {}, make("div", { class: "clvol-buttons" }, make("span", {}, "Copy as"), ...buttons), this.files.element, this.text);
  }

  statisticsControls() {
    this.statistics = make("dl", { class: "clvol-statistics" });
    this.heat = toggle("Show visited samples", this.setter("heat"), "heat map of the fraction of samples that rays visit");
    return make("div", {}, this.statistics, this.heat.element);
  }

  // The volume

  /** The crop box, by default the whole volume. */
  box() {
    const [low, high] = this.viewer.info.volume.bounds;
    return { low, high };
  }

  cropTo(axis, side, value, live) {
    const clip = structuredClone(this.viewer.state.clip ?? this.box());
    const { low, high } = this.box();
    const least = (high[axis] - low[axis]) / 1000;
    clip[side][axis] = side === "low" ? Math.min(value, clip.high[axis] - least) : Math.max(value, clip.low[axis] + least);
    this.viewer.set({ clip }, live);
  }

  tell(info) {
    const names = (found) => (Array.isArray(found) ? found.map((f) => f.name ?? f) : Object.keys(found ?? {}));
    this.mode.fill(names(info.modes));
    this.filter.fill([["", "automatic"], ...names(info.filters)]);
    this.other.fill(names(info.filters));
    this.other.show("linear");
    this.boundary.fill(names(info.boundaries).length ? names(info.boundaries) : ["mirror"]);
    this.boundary.element.hidden = names(info.boundaries).length < 2;
    this.preset.fill([["", "automatic"], ...names(info.presets)]);
    this.cmap.fill([["", "the preset's"], ...names(info.colormaps)]);
    this.plane.fill(["z", "y", "x"].map((axis) => [axis, this.viewer.paneName(axis)]));
    const { low, high } = this.box();
    [...this.crosshair.entries()].forEach(([i, c]) => c.limit(low[i], high[i]));
    this.crop.forEach((c, i) => c.limit(low[i >> 1], high[i >> 1]));
    const [least, most] = info.volume.range;
    this.level.limit(least, most);
    this.width.limit((most - least) / 1000, most - least);
    this.views.replaceChildren(...facesOf(info.volume.space).map(({ name, title, normal }) => button(name, () => this.viewer.look(normal), { title })));
    this.thickness.limit(0, Math.min(...high.map((c, i) => c - low[i])));
    const { labels } = info.volume;
    this.projected.fill([["mip", "the largest"], ["minip", "the smallest"], ...(labels ? [] : [["mean", "the mean"]])]);
    this.contour.element.hidden = !labels;
    this.made = null;
    this.around.find(([name]) => name === "letters")[1].element.hidden = info.volume.space !== "LPS";
    this.axes.tell(info);
    this.layers.tell(info);
    this.labels.tell(info);
  }

  show(state) {
    const { viewer } = this;
    this.undo.disabled = !viewer.canUndo;
    this.redo.disabled = !viewer.canRedo;
    this.layout.show(state.layout);
    this.tool.show(state.tool === "orbit" || state.tool === "crosshair" || state.tool in MEASURES ? "" : state.tool);
    this.mode.show(state.mode);
    this.showOptions(state);
    const matter = state.mode === "composite" && !viewer.info.volume.labels;
    const edited = Boolean(state.transfer?.points || (state.transfer && matter));
    const joint = edited && !state.transfer.points;
    this.colored = edited ? state.transfer : viewer.effective.transfer;
    this.saved.disabled = !this.colored || this.colored.points?.length === 0; // of many labels
    this.preset.show(edited ? EDITED : state.preset);
    this.nameEdited(edited);
    this.cmap.show(state.cmap);
    this.opacity.show(state.opacity ?? 1);
    this.opacity.element.hidden = edited;
    this.graded.show(joint);
    this.graded.element.hidden = !matter;
    this.transfer.element.hidden = joint;
    this.joint.element.hidden = !joint;
    if (joint) this.joint.show(state.transfer);
    this.edges.show(state.gradient_opacity);
    this.edges.element.hidden = state.mode !== "composite";
    const isovalue = typeof state.options.isovalue === "number" ? state.options.isovalue : viewer.effective.options?.isovalue; // not "3sigma"
    this.transfer.show(state.transfer?.points ?? viewer.effective.transfer?.points, state.mode === "isosurface" ? isovalue : null);
    this.filter.show(state.filter);
    this.boundary.show(state.boundary);
    this.step.show(state.step);
    this.compare.show(state.wiper);
    this.other.element.hidden = this.errors.hidden = !state.wiper;
    this.filter.list.options[0].textContent = state.filter || !viewer.effective.filter ? "automatic" : `auto: ${viewer.effective.filter}`;
    if (state.wiper) this.other.show(state.wiper.filter);
    this.plane.show(state.active === "3d" ? "z" : state.active);
    (state.crosshair ?? viewer.info.volume.center).forEach((value, i) => this.crosshair[i].show(value));
    const [level, width] = this.sliceWindow();
    this.level.show(level);
    this.width.show(width);
    this.thickness.show(state.slice.thickness);
    this.projected.show(state.slice.project);
    this.projected.element.hidden = !state.slice.thickness;
    this.contour.show(state.slice.contour);
    this.contour.unheard(state.slice.thickness ? "of a plane: the thickness must be 0" : "");
    this.alike.show(state.slice.alike);
    this.straight.disabled = !state.slice.turn;
    this.projection.show(state.camera.projection);
    this.style.show(state.camera.style);
    this.fov.show(state.camera.fov);
    this.zoom.show(Math.log2(state.camera.zoom ?? 1));
    this.light.show(this.lightName(state.lights));
    for (const [name, control] of this.material) control.show(state.material?.[name] ?? MATERIAL[name][2]);
    const factors = state.transfer?.gradient_opacity || state.transfer?.curvature_opacity;
    const graded = state.mode === "composite" && (state.gradient_opacity > 0 || joint || factors);
    const passes = graded || !viewer.info.stops_light ? "light is stopped by values alone: not beside Edges, or opacity by the gradient too" : "";
    for (const [name, control] of this.dark) {
      control.show(state[name]);
      control.unheard(passes);
    }
    this.rays.show(state.shadow_rays);
    this.linear.show(state.linear_light);
    this.background.show(state.background ?? [0, 0, 0]);
    this.cropping.show(state.clip);
    const { low, high } = state.clip ?? this.box();
    this.crop.forEach((c, i) => {
      c.show((i % 2 ? high : low)[i >> 1]);
      c.element.hidden = !state.clip;
    });
    for (const [name, control] of this.around) control.show(state.furniture[name]);
    this.heat.show(state.heat);
    this.axes.show(state);
    this.layers.show(state);
    this.measures.show(state);
    this.labels.show(state);
  }

  nameEdited(edited) {
    for (const option of [...this.preset.list.options].filter((o) => o.value === EDITED)) {
      option.textContent = "edited";
      if (!edited) option.remove();
    }
  }

  lightName(lights) {
    const plain = (list) => list && list.map((l) => [l.direction && l.direction.map((c) => c / Math.hypot(...l.direction)).map((c) => c.toFixed(3)), l.frame ?? "world"]);
    return Object.keys(LIGHTS).find((name) => same(plain(LIGHTS[name]), plain(lights))) ?? "others";
  }

  /** A control for each option of the mode, by its kind. */
  showOptions(state) {
    const known = this.viewer.info.modes[state.mode] ?? {};
    if (this.made !== state.mode) {
      this.made = state.mode;
      this.optionControls = Object.entries(known).map(([name, about]) => [name, about, this.optionControl(name, about)]);
      const shown = (advanced) => this.optionControls.filter(([name]) => ADVANCED.includes(name) === advanced).map(([, , control]) => control.element);
      this.options.replaceChildren(...shown(false));
      this.advanced.replaceChildren(...shown(true));
    }
    for (const [name, about, control] of this.optionControls) control.show(state.options?.[name] ?? this.viewer.effective.options?.[name] ?? about.default);
  }

  optionControl(name, about) {
    const change = this.setter(`options.${name}`);
    const edges = this.viewer.info.histogram?.edges ?? [0, 1];
    if (about.kind === "flag") return toggle(name, change, about.help);
    if (about.kind === "color") return colorBox(name, change);
    if (about.kind === "surfaces") return surfacesBox(name, change, about.help);
    if (about.kind === "choice") {
      const made = choice(name, change, about.help);
      made.fill(about.choices);
      return made;
    }
    const [low, high] = name === "isovalue" ? [edges[0], edges.at(-1)] : (about.range ?? [0, 1]);
    return slider(name, { low, high, step: about.step, scale: about.scale, open: true }, change, about.help);
  }

  /** `errors`: measured by the session for both filters. */
  tellErrors(errors) {
    const known = (value, digits = 3) => (Number.isFinite(value) ? short(value, digits) : "unknown");
    const lines = (errors?.filters ?? []).map((e) => `${e.filter}: left out ${known(e.rms)}, expected ${known(e.expected)}`);
    this.errors.replaceChildren(...lines.flatMap((line) => [line, make("br")]), errors ? errors.problem ?? errors.meaning ?? "" : "measuring the errors");
  }

  stats(stats) {
    const rows = [
      ["frames per second", short(stats.fps, 3)],
      ["latency", Number.isFinite(stats.latency_ms) ? `${short(stats.latency_ms, 3)} ms` : NOTHING],
      ["samples visited", Number.isFinite(stats.visited) ? `${short(100 * stats.visited, 3)} %` : NOTHING],
      ["picture", stats.picture ?? NOTHING],
    ];
    this.statistics.replaceChildren(...rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
  }
}
