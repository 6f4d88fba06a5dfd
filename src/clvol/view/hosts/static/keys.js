// -- keys: they go to the session wherever the focus is, but for what a control there needs itself ----------------

const FIELDS = "input:not([type=range], [type=checkbox], [type=color], [type=file]), textarea"; // with their own undo
const SHORTCUTS = /^(Arrow(Left|Right|Up|Down)|Page(Up|Down)|Home|Escape|[-+=[\],.1-9cfhilprtuwxyz])$/i;
const OF_SLIDERS = /^(Arrow.*|Page.*|Home|End)$/;
const REPEATED = /^(Arrow.*|Page.*|[-+=[\],.])$/; // others switch something
const SIGNS = /^[-+=[\],.]$/; // some keyboards need Alt for them

class Keys {
  constructor(viewer) {
    this.viewer = viewer;
    this.held = new Set();
    this.stop = new AbortController();
    const on = (place, type, work) => place.addEventListener(type, work, { signal: this.stop.signal });
    const place = viewer.embedded ? viewer.root : document; // a page has keys for nothing else
    on(place, "keydown", (event) => this.down(event));
    on(place, "keyup", (event) => this.up(event));
    this.help = make("dialog", { class: "clvol-help", "aria-label": "keys" });
    this.help.addEventListener("click", ({ target }) => target === this.help && this.help.close()); // beside the list
    this.button = button("Keys", () => this.help.showModal(), { kind: "clvol-hide", title: "all keys (?)" });
    on(window, "blur", () => this.release());
    on(viewer.root, "focusout", ({ relatedTarget: to }) => viewer.root.contains(to) || this.release()); // its release may not be seen
  }

  close() {
    this.stop.abort();
    this.help.close();
  }

  /** Lists the keys of the session. */
  tell(keys = {}) {
    const rows = Object.entries({ ...keys, "?": "this list" }).flatMap(([key, text]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, text)]);
    const done = button("Close", () => this.help.close());
    this.help.replaceChildren(make("dl", { class: "clvol-statistics clvol-keys" }, ...rows), done);
  }

  down(event) {
    const { key, target } = event;
    const typed = event.getModifierState("AltGraph");
    const command = (event.ctrlKey || event.metaKey) && !typed;
    if (event.defaultPrevented || target.matches(FIELDS) || (event.altKey && !typed && !SIGNS.test(key))) return;
    if (command) {
      if (!["z", "y"].includes(key.toLowerCase())) return;
      this.take(event);
      this.viewer.ask(key.toLowerCase() === "y" || event.shiftKey ? "redo" : "undo");
      return;
    }
    if (this.viewer.embedded && key !== "Tab") event.stopPropagation(); // notebooks have their own shortcuts
    if (key === "?") {
      this.take(event);
      if (this.help.open) this.help.close();
      else this.help.showModal();
      return;
    }
    if (this.help.open) return;
    if (!SHORTCUTS.test(key) || this.needs(target, key)) return;
    this.take(event);
    if (event.repeat && !REPEATED.test(key)) return;
    this.held.add(key);
    this.send("key_down", key, { modifiers: modifiersOf(event), pane: target.closest(".clvol-pane")?.dataset.pane });
  }

  up(event) {
    if (!this.held.delete(event.key)) return;
    this.take(event);
    this.send("key_up", event.key, { modifiers: modifiersOf(event) });
  }

  release() {
    for (const key of this.held) this.send("key_up", key, { modifiers: [] });
    this.held.clear();
  }

  /** Whether a control has a use of its own for a key. */
  needs(target, key) {
    return target.matches("select") || (target.matches("input[type=range], [role=slider]") && OF_SLIDERS.test(key));
  }

  take(event) {
    event.preventDefault();
    event.stopPropagation();
  }

  /** To the pane that has the focus, else to the active one. */
  send(event_type, key, more) {
    this.viewer.channel.send({ type: "event", event: { event_type, key, ...more } });
  }
}
