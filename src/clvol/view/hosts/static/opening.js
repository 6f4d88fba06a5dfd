// -- volumes that are opened as layers: from the folder of clvol, from this device, dropped on the page -----------------

class Opening {
  constructor(viewer) {
    this.viewer = viewer;
    this.list = make("select", { size: 7, "aria-label": "volumes in the folder of clvol", ondblclick: () => this.open() });
    this.place = make("span", { class: "clvol-note" });
    const file = make("input", { type: "file", multiple: true, hidden: true, "aria-label": "files of this device", onchange: () => this.send([...file.files]).then(() => (file.value = "")) });
    const buttons = [button("Show", () => this.open(), { title: "show the volume as a layer" }), button("From this device", () => file.click(), { title: "send a file of this device to clvol" })];
    this.box = make("div", { class: "clvol-opening", hidden: true }, this.place, this.list, make("div", { class: "clvol-buttons" }, ...buttons, file));
    this.button = button("Open\u2026", () => this.toggle(), { title: "show another volume as a layer; or drop its file on the page", kind: "clvol-open" });
    this.button.setAttribute("aria-expanded", "false");
    this.stop = new AbortController();
  }

  /** Takes files that are dropped on an element. */
  listen(root) {
    const over = (event, on) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      root.classList.toggle("clvol-dropping", on);
    };
    const on = (type, work) => root.addEventListener(type, work, { signal: this.stop.signal });
    on("dragenter", (event) => over(event, true));
    on("dragover", (event) => over(event, true));
    on("dragleave", (event) => event.relatedTarget || over(event, false));
    on("drop", (event) => {
      over(event, false);
      this.send([...event.dataTransfer.files]);
    });
  }

  close() {
    this.stop.abort();
  }

  async toggle() {
    const open = this.box.hidden;
    if (open && !(await this.fill())) return;
    this.box.hidden = !open;
    this.button.setAttribute("aria-expanded", String(open));
  }

  /** Lists the volumes; those that were opened last come first. */
  async fill() {
    const found = await this.ask("files");
    if (!found) return false;
    const group = (label, names) => (names.length ? [make("optgroup", { label }, ...names.map((name) => new Option(name, name)))] : []);
    this.list.replaceChildren(...group("Recent", found.recent), ...group(found.folder ?? "", found.files));
    this.list.hidden = !found.files.length;
    this.place.textContent = found.files.length ? "" : "no volumes are in the folder of clvol";
    return true;
  }

  async open() {
    const name = this.list.value;
    if (name && (await this.ask(`open?name=${encodeURIComponent(name)}`, { method: "POST" }, name))) await this.fill();
  }

  async send(files) {
    const most = this.viewer.channel.upload;
    const mib = (bytes) => Math.ceil(bytes / 2 ** 20);
    const large = files.filter(({ size }) => size > most).map(({ name, size }) => `${name} has ${mib(size)} MiB`);
    const words = `${large.join(", ")}; a file that is sent may have up to ${mib(most)} MiB: put it into the folder of clvol, and open it from there`;
    const refuse = () => large.length && this.viewer.status(words, "error");
    refuse();
    for (const file of files.filter(({ size }) => size <= most)) {
      const headers = { "Content-Type": "application/octet-stream" };
      await this.ask(`upload?name=${encodeURIComponent(file.name)}`, { method: "POST", headers, body: file }, file.name);
    }
    refuse(); // what was read meanwhile took its place
  }

  /** An answer of the server; if it refuses, its reason is shown. */
  async ask(path, options = {}, reads = "") {
    if (reads) this.viewer.status(`reading ${reads}`, "busy");
    try {
      const answer = await fetch(path, { ...options, headers: { ...options.headers, ...this.viewer.channel.headers } });
      if (!answer.ok) throw new Error((await answer.text()).replace(/^clvol: /, "").trim());
      const found = await answer.json();
      if (reads) this.viewer.status("");
      return found;
    } catch (error) {
      this.viewer.status(error.message, "error");
      return null;
    }
  }
}
