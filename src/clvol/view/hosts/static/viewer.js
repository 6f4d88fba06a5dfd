// -- the viewer: panes, panel, and the channel to the session ----------------------------------------------------

class Viewer {
  constructor(element, channel, { embedded = false, onLink = null, opens = false } = {}) {
    Object.assign(this, { channel, embedded, onLink, opens });
    this.info = null;
    this.state = null;
    this.confirmed = null; // the session's last state
    this.unheard = []; // changes that it does not include
    this.lastSet = 0;
    this.heard = -1; // number of the last change that the session's state includes
    this.effective = {}; // values where the state leaves them open
    this.errors = null; // of the wiper's filters
    this.overlays = new Map(); // the last message of each pane
    this.panes = new Map();
    this.asked = new Map();
    this.lastId = 0;
    this.gesture = 0; // number of the gesture, which is one step of undo
    this.picture = NOTHING;
    this.said = { text: "", kind: "info" }; // by the session
    this.noted = ""; // a line that stays until something is done
    this.onConfirmed = () => {};
    this.grid = make("div", { class: "clvol-panes" });
    this.line = make("div", { class: "clvol-status", role: "status", "aria-live": "polite" }, make("span", {}, WAITING));
    this.panel = new Panel(this);
    this.root = make("div", { class: `clvol${embedded ? " clvol-embedded" : ""}` });
    this.keys = new Keys(this);
    this.hide = button("Settings", () => this.togglePanel(), { kind: "clvol-hide", title: "show or hide the settings" });
    this.hide.setAttribute("aria-expanded", "true");
    const stage = make("div", { class: "clvol-stage" }, this.grid, make("div", { class: "clvol-foot" }, this.line, this.keys.button, this.hide));
    this.inner = make("div", { class: "clvol-frame" }, stage, this.panel.element);
    this.heading = embedded ? null : make("h1", { class: "clvol-offscreen" }, "clvol"); // notebooks have their own
    this.root.append(...[this.heading, this.inner, this.keys.help].filter(Boolean));
    this.panel.layers.opening?.listen(this.root);
    for (const type of ["pointerdown", "keydown"]) this.root.addEventListener(type, () => this.begun(), true);
    element.replaceChildren(this.root);
    channel.onmessage = (message, data) => this.receive(message, data);
  }

  close() {
    this.channel.onmessage = () => {};
    for (const pane of this.panes.values()) pane.close();
    this.panes.clear();
    this.panel.close();
    this.keys.close();
    for (const { refused } of this.asked.values()) refused(new Error("the viewer was closed"));
    this.root.remove();
  }

  togglePanel() {
    const hidden = this.inner.classList.toggle("clvol-alone");
    this.hide.setAttribute("aria-expanded", String(!hidden));
  }

  paneName(name) {
    return (this.info?.volume?.space === "LPS" ? PATIENT_PANES : PANE_NAMES)[name];
  }

  // From the session

  receive(message, data) {
    if (message.type === "frame") this.frame(message, data);
    else if (message.type === "info") this.tell(message);
    else if (message.type === "state") this.take(message);
    else if (message.type === "stats") this.panel.stats({ ...message, picture: this.picture });
    else if (message.type === "status") this.report(message);
    else if (message.type === "reply") this.reply(message, data);
    else if (message.type === "overlay") this.overlay(message);
    else if (message.type === "readout") for (const pane of this.panes.values()) pane.readout.show(pane.name === message.pane ? message : null);
    else if (message.type === "job") this.panel.files.tell(message);
    else if (message.type === "curve") this.panel.axes.series.tellCurve(message);
    else if (message.type === "measures") this.measured(message);
    else if (message.type === "joint") this.panel.joint.tell(message);
    else if (message.type === "wiper") this.compared(message.errors);
  }

  tell(info) {
    this.info = info;
    if (this.onLink && info.title) document.title = `${info.title} · clvol`;
    if (info.title) this.heading?.replaceChildren(info.title);
    this.keys.tell(info.keys);
    this.panel.tell(info);
    if (this.state) this.show();
  }

  take(message) {
    this.state = message.state;
    this.confirmed = structuredClone(message.state);
    this.heard = message.heard ?? this.heard;
    this.unheard = this.unheard.filter(({ number }) => !(number <= message.heard));
    for (const { changes, whole } of this.unheard) this.apply(changes, whole);
    this.canUndo = message.can_undo;
    this.canRedo = message.can_redo;
    this.effective = message.effective ?? this.effective;
    this.onConfirmed(this.confirmed);
    this.show();
  }

  measured(message) {
    this.panel.measures.tell(message);
    for (const pane of this.panes.values()) pane.decorate();
  }

  overlay(message) {
    this.overlays.set(message.pane, message);
    this.panes.get(message.pane)?.decorate(message);
  }

  /** The measured errors of the two filters. */
  compared(errors) {
    this.errors = errors;
    this.panel.tellErrors(errors);
    this.show();
  }

  show() {
    if (!this.state || !this.info) return;
    this.arrange();
    this.panel.show(this.state);
    for (const pane of this.panes.values()) {
      pane.wiper.show(this.state, this.effective.filter, this.errors?.filters);
      pane.element.classList.toggle("clvol-active", this.panes.size > 1 && pane.name === this.state.active);
    }
  }

  /** The panes of the layout; those that stay keep their pictures, and a pane keeps the focus. */
  arrange() {
    const { layout, active, enlarged } = this.state;
    const alone = layout === "linked" && enlarged;
    const wanted = layout === "slice" ? [active === "3d" ? "z" : active] : alone ? [active] : PANES[layout];
    if (same([...this.panes.keys()], wanted)) return;
    const focused = this.grid.contains(document.activeElement);
    for (const [name, pane] of this.panes) {
      if (wanted.includes(name)) continue;
      pane.close();
      this.panes.delete(name);
    }
    const panes = wanted.map((name) => [name, this.panes.get(name) ?? new Pane(this, name)]);
    this.panes = new Map(panes);
    this.grid.dataset.layout = alone ? "slice" : layout;
    let next = this.grid.firstElementChild;
    for (const [, { element }] of panes) {
      if (element === next) next = next.nextElementSibling; // one that is moved would lose the focus
      else this.grid.insertBefore(element, next);
    }
    if (focused && !this.grid.contains(document.activeElement)) (this.panes.get(active) ?? panes[0][1]).element.focus({ preventScroll: true });
    for (const [name, pane] of panes) pane.decorate(this.overlays.get(name));
    for (const [name, pane] of panes) pane.element.setAttribute("aria-label", `${this.info.title ?? "volume"}, ${this.paneName(name)}`);
  }

  frame(message, data) {
    if (this.line.textContent === WAITING) this.status(""); // in notebooks no connection clears it
    if (!this.hinted && !this.line.textContent) this.status(HINT);
    this.hinted = true;
    const pane = this.panes.get(message.pane ?? "3d");
    if (!pane || !data) return this.channel.send({ type: "ack", frame: message.number });
    const step = message.step ? `, step ${short(message.step, 3)}` : "";
    this.picture = `${message.width} × ${message.height}${step}, ${short(1000 * (message.seconds ?? 0), 3)} ms${message.final ? ", final" : ""}`;
    return pane.take({ ...message, heard: this.heard }, data);
  }

  status(text, kind = "info") {
    this.line.firstElementChild.textContent = text || this.noted;
    this.line.dataset.kind = !text && this.noted ? "error" : kind;
  }

  /** Something was done: what was to be read before is over. */
  begun() {
    if (this.noted) this.note("");
    else if (this.line.textContent === HINT) this.status("");
  }

  /** Shows an error whenever there is no other status, until something is done. */
  note(text) {
    this.noted = text;
    this.status("");
  }

  /** A status of the session; after an error, which may concern a change made here, its last state is shown. */
  report({ text, kind }) {
    this.said = { text, kind };
    this.status(text, kind);
    if (kind !== "error" || !this.confirmed) return;
    this.unheard = [];
    this.panel.axes.series.stop();
    this.state = structuredClone(this.confirmed);
    this.show();
  }

  // To the session

  /** Changes fields of the state by dotted names; changes while a control moves are `live`: one step of undo. */
  set(changes, live = false) {
    if (!this.state) return;
    this.apply(changes);
    this.tellSet({ changes, live, gesture: `panel-${this.gesture}` });
    if (!live) this.gesture += 1;
    this.show();
  }

  /** Sends the whole state to a session that does not have it. */
  setAll() {
    this.unheard = [];
    if (this.state) this.tellSet({ changes: structuredClone(this.state), whole: true });
  }

  tellSet({ changes, whole, ...more }) {
    this.begun();
    this.lastSet += 1;
    this.unheard.push({ number: this.lastSet, changes, whole });
    this.channel.send({ type: "set", changes, whole, number: this.lastSet, ...more });
  }

  /** Applies changes to the state shown here. */
  apply(changes, whole = false) {
    if (whole) {
      this.state = structuredClone(changes);
      return;
    }
    if ("mode" in changes && changes.mode !== this.state.mode) this.state.options = {};
    for (const [name, value] of Object.entries(changes)) {
      const words = name.split(".");
      let part = this.state;
      for (const word of words.slice(0, -1)) part = part[word] ??= {};
      part[words.at(-1)] = value;
    }
  }

  /** Looks at the volume from the side of a face. */
  look(normal) {
    const { space } = this.info.volume;
    const level = Math.abs(normal[2]) < 0.5;
    const up = level ? [0, 0, space === "image" ? -1 : 1] : [0, ["LPS", "image"].includes(space) ? -1 : 1, 0];
    this.set({ "camera.direction": normal.map((c) => 0 - c), "camera.up": up });
  }

  /** Ends live changes: the next one is a new step of undo. */
  settle() {
    this.channel.send({ type: "set", changes: {}, gesture: `panel-${this.gesture++}` });
  }

  /** Sends a request; the promise is of {message, data}. */
  ask(what, more = {}) {
    const id = ++this.lastId;
    const answer = new Promise((answered, refused) => this.asked.set(id, { answered, refused }));
    this.channel.send({ type: "do", what, id, ...more });
    answer.catch((error) => this.status(error.message, "error"));
    return answer;
  }

  reply(message, data) {
    if (message.what === "pick") return this.picked(message);
    const waiting = this.asked.get(message.id);
    this.panel.files.end(message.id);
    this.asked.delete(message.id);
    if (!waiting) return;
    if (message.error) waiting.refused(new Error(message.error));
    else waiting.answered({ message, data });
  }

  /** Shows what was picked. */
  picked({ position, value, steepness, units, label }) {
    if (!position) return this.status("nothing under the pointer");
    const parts = [`(${position.map((c) => short(c, 5)).join(", ")}) ${units}`.trim(), `value ${short(value, 6)}${label ? `, ${label}` : ""}`];
    if (steepness !== undefined) parts.push(`gradient ${short(steepness)}${units ? ` per ${units}` : ""}`);
    return this.status(parts.join(" · "));
  }

  async copy(what, name) {
    const answer = await this.ask(what).catch(() => null); // the error is shown already
    if (!answer) return;
    const { message } = answer;
    let { text = message.url ?? "" } = message;
    if (what === "copy_url" && this.onLink) text = this.onLink(text);
    const copied = await toClipboard(text);
    const box = this.panel.text;
    Object.assign(box, { hidden: copied, value: text });
    if (!copied) box.select();
    this.status(copied ? `copied as ${name}` : "no access to the clipboard: copy the selected text", copied ? "info" : "error");
  }

  /** Has a file made, which takes a while, and downloads it. */
  async save(what, more = {}) {
    const answer = await this.ask(what, more).catch(() => null); // the error is shown already
    if (!answer) return undefined;
    const { message } = answer;
    if (message.cancelled) return this.status("cancelled");
    const data = message.download ? await this.fetched(message.download).catch((error) => this.status(error.message, "error")) : answer.data;
    if (message.download && !data) return undefined; // the error is shown already
    if (!data) return this.status(message.text ?? "no result", "error");
    return this.download(new Blob([data], { type: KINDS[message.format] ?? `image/${message.format}` }), message.name, message.note);
  }

  /** What is too large for the socket. */
  async fetched(name) {
    const answer = await fetch(`download?name=${encodeURIComponent(name)}`, { headers: this.channel.headers });
    if (!answer.ok) throw new Error((await answer.text()).replace(/^clvol: /, "").trim());
    return answer.blob();
  }

  download(blob, name, note = "") {
    const url = URL.createObjectURL(blob);
    make("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
    this.status([`saved as ${name}`, note].filter(Boolean).join("; "), note ? "warning" : "info");
  }
}
