// The page: the picture, its sliders, the slices.

const COARSE_MS = 40;   // of a picture while something moves
const REST_MS = 150;    // after which it is drawn in full

const find = (id) => document.getElementById(id), canvas = find("picture"), said = find("said");
const say = (text) => { said.textContent = text; said.hidden = !text; };

class Page {
  constructor() {
    this.camera = new Camera();
    this.drawing = new Drawing(canvas, say);
    this.scale = 0.25;   // of the picture's pixels while something moves
    this.wanted = 0;     // how often a picture was asked for
    this.cut = null;
    this.pointers = new Map();
  }

  async open() {
    this.drawing.load(await decoded());
    this.sliders();
    this.listen();
    new ResizeObserver(() => this.move()).observe(canvas);  // a coarse picture first: a whole one may take long
  }

  /** Width and height in device pixels. */
  get pixels() {
    const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    return [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
  }

  /** Draws a coarse picture, and the whole one once nothing moves. */
  move() {
    clearTimeout(this.later);
    ++this.wanted;
    this.later = setTimeout(() => this.rest(), REST_MS);
    if (this.moving) return void (this.again = true);
    this.moving = true;
    requestAnimationFrame(async () => {
      const [width, height] = this.pixels.map((n) => Math.max(1, Math.round(n * this.scale))), begun = performance.now();
      this.drawing.draw(this.camera, width, height, this.cut);
      canvas.dataset.final = "false";
      await this.drawing.done();
      const ratio = COARSE_MS / Math.max(1, performance.now() - begun);
      this.scale = Math.min(1, Math.max(0.1, this.scale * Math.min(1.5, Math.max(0.5, Math.sqrt(ratio)))));
      this.moving = false;
      if (this.again) {
        this.again = false;
        this.move();
      }
    });
  }

  async rest() {
    clearTimeout(this.later);
    const mine = ++this.wanted, [width, height] = this.pixels;
    canvas.dataset.final = "false";
    if (await this.drawing.drawn(this.camera, width, height, this.cut, () => mine !== this.wanted)) canvas.dataset.final = "true";
  }

  listen() {
    const aspect = () => canvas.clientWidth / canvas.clientHeight, per = () => 1 / canvas.clientHeight;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { pointerId: event.pointerId, button: event.button, clientX: event.clientX, clientY: event.clientY });
    });
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (!before) return;
      const x = (event.clientX - before.clientX) * per(), y = (event.clientY - before.clientY) * per();
      const other = [...this.pointers.values()].find((one) => one.pointerId !== event.pointerId);
      if (other) {
        const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) + 1;
        this.camera.zoom *= apart(event) / apart(before);
        this.camera.pan(x / 2, y / 2, aspect());
      } else if (event.shiftKey || before.button > 0) this.camera.pan(x, y, aspect());
      else this.camera.turn(-Math.PI * x, Math.PI * y);
      Object.assign(before, { clientX: event.clientX, clientY: event.clientY });
      this.move();
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => {
      this.camera.reset();
      this.move();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.zoom *= Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015));
      this.move();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (way && event.shiftKey) this.camera.pan(way[0] / 20, way[1] / 20, aspect());
      else if (way) this.camera.turn((-way[0] * Math.PI) / 36, (way[1] * Math.PI) / 36);
      else if (event.key === "+" || event.key === "=") this.camera.zoom *= 1.1;
      else if (event.key === "-") this.camera.zoom /= 1.1;
      else if (event.key === "Home" || event.key === "r") this.camera.reset();
      else return;
      event.preventDefault();
      this.move();
    });
  }

  sliders() {
    const value = find("isovalue"), cut = find("cut");
    if (look.surfaces.length === 1 && !look.names) {
      const shown = (v) => Number((look.offset + look.scale * v).toPrecision(4));
      find("isovalue-row").hidden = false;
      value.value = look.surfaces[0][0];
      find("isovalue-is").textContent = shown(look.surfaces[0][0]);
      value.addEventListener("input", () => {
        look.surfaces[0][0] = Number(value.value);
        find("isovalue-is").textContent = shown(look.surfaces[0][0]);
        this.drawing.look();
        this.move();
      });
    }
    cut.addEventListener("input", () => {
      const share = Number(cut.value), { toIndex, toWorld, center, unit, size } = look;
      if (share === 0) this.cut = null;
      else {
        // across the view of when it was moved from 0, between the volume's nearest corner and its farthest
        if (!this.cut) this.facing = times(this.camera.forward, -1);
        const ends = [];
        for (const x of [-0.5, 0.5]) for (const y of [-0.5, 0.5]) for (const z of [-0.5, 0.5]) ends.push(dot(apply(toWorld, [x * size[0], y * size[1], z * size[2]]), this.facing) * unit);
        const depth = Math.max(...ends) + share * (Math.min(...ends) - Math.max(...ends));
        const columns = [0, 1, 2].map((i) => dot([toWorld[i], toWorld[3 + i], toWorld[6 + i]], this.facing) * unit);
        this.cut = [...columns, depth + dot(columns, size.map((n) => (n - 1) / 2))];
      }
      this.move();
    });
    const slices = find("slices"), button = find("slices-button");
    button.addEventListener("click", () => {
      slices.hidden = !slices.hidden;
      button.setAttribute("aria-pressed", String(!slices.hidden));
      look.slices.forEach((one, k) => this.slice(one, k));
    });
    look.slices.forEach((one, k) => find(`slice-${k}`).addEventListener("input", () => this.slice(one, k)));
  }

  /** Draws slice number k where its slider is. */
  slice([name, axis, across, acrossSign, down, downSign], k) {
    const pane = find(`slice-canvas-${k}`), { size, spacing } = look, share = Number(find(`slice-${k}`).value);
    const corner = [0, 0, 0], right = [0, 0, 0], below = [0, 0, 0], wide = size[across] * spacing[across], high = size[down] * spacing[down];
    const pixels = Math.min(1024, Math.round(320 * (window.devicePixelRatio || 1))), most = Math.max(wide, high);
    const [width, height] = [wide, high].map((n) => Math.max(1, Math.round((n / most) * pixels)));
    corner[axis] = share * (size[axis] - 1);
    for (const [way, i, sign] of [[right, across, acrossSign], [below, down, downSign]]) {
      corner[i] = sign > 0 ? look.uniforms.low[i] : look.uniforms.high[i];
      way[i] = sign * (look.uniforms.high[i] - look.uniforms.low[i]);
    }
    Object.assign(pane, { width, height });
    pane.getContext("2d").putImageData(this.drawing.slice(corner, right, below, width, height), 0, 0);
  }
}

const failed = (error) => say(error.message);
try {
  const page = new Page();
  page.open().catch(failed);
} catch (error) {
  failed(error);
}
