// WebGL2: textures, programs, pictures.

const source = (...names) => "#version 300 es\n" + names.map((name) => document.getElementById(name).textContent).join("\n");

class Drawing {
  /** `lost` is called with a text when the device gives up. */
  constructor(canvas, lost) {
    const options = { alpha: true, antialias: false, depth: false, preserveDrawingBuffer: true, powerPreference: "high-performance" };
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", options);
    if (!this.gl) throw new Error("This browser does not offer WebGL2, which draws the picture.");
    canvas.addEventListener("webglcontextlost", () => lost("The graphics device was lost: load the page again."));
    this.size = look.halo.map((places) => places.length);
    const most = this.gl.getParameter(this.gl.MAX_3D_TEXTURE_SIZE);
    if (Math.max(...this.size) > most)
      throw new Error(`This device holds volumes of up to ${most} samples along an axis; this one has ${Math.max(...this.size)}.`);
    this.programs = new Map();
  }

  load(texels) {
    const { gl, size } = this;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.coefficients = this.texture(gl.TEXTURE_3D, look.filter ? gl.LINEAR : gl.NEAREST);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RG8, ...size, 0, gl.RG, gl.UNSIGNED_BYTE, texels);
    this.bricks = boundsOf(texels, size);
    this.worth = this.texture(gl.TEXTURE_3D, gl.NEAREST);
    this.pieces = this.texture(gl.TEXTURE_2D, gl.NEAREST);
    const rows = look.pieces.flatMap(([start, length, from, until]) => [...from, ...until, start, length, 0, 0]);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 3, look.pieces.length, 0, gl.RGBA, gl.FLOAT, new Float32Array(rows));
    this.look();
    this.coarse = look.filter > 0 && this.samplesCoarsely();
    if (gl.getError()) throw new Error("The graphics device has no room for the volume.");
  }

  /** What depends on the isovalue. */
  look() {
    const { gl, bricks } = this;
    gl.bindTexture(gl.TEXTURE_3D, this.worth);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R32F, ...bricks.blocks, 0, gl.RED, gl.FLOAT, worthOf(bricks));
  }

  texture(kind, filter) {
    const { gl } = this, made = gl.createTexture();
    gl.bindTexture(kind, made);
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, filter);
    for (const along of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(kind, along, gl.CLAMP_TO_EDGE);
    return made;
  }

  /** A picture beside the canvas, which is drawn to from now on: the framebuffer and its texture. */
  target(width, height) {
    const { gl } = this, target = gl.createFramebuffer(), texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    return [target, texture];
  }

  /** Whether the sampler's weights have so few bits, 8 on most devices, that a picture at rest shows it. */
  samplesCoarsely() {
    const { gl } = this, pixels = new Uint8Array(4 * PROBES);
    const probe = this.texture(gl.TEXTURE_3D, gl.LINEAR);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RG8, 2, 1, 1, 0, gl.RG, gl.UNSIGNED_BYTE, new Uint8Array([0, 0, 255, 0]));
    const [target, texture] = this.target(PROBES, 1);
    this.program("probe.glsl").probe(0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_3D, probe);
    gl.viewport(0, 0, PROBES, 1);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, PROBES, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    for (const made of [probe, texture]) gl.deleteTexture(made);
    gl.deleteFramebuffer(target);
    return pixels.some((level, i) => i % 4 === 0 && Math.abs(level - 64) > 16); // exact weights give 64 in all
  }

  /** The program of a picture, of slices or of the probe, with its textures. */
  program(name) {
    const { gl } = this;
    if (!this.programs.has(name)) {
      const mode = { composite: 0, surfaces: 1 }[look.mode] ?? 2;
      const defines = { FILTER: look.filter, NAMES: +look.names, LINEAR: +look.linear, SHADED: +look.shaded, MODE: mode, BRICK: "8.0", CUTS: MOST_CUTS };
      const head = Object.entries(defines).map(([key, value]) => `#define ${key} ${value}`).join("\n");
      const text = source("function.glsl", "look.glsl", name).replace("\n", `\n${head}\n`);
      const program = gl.createProgram();
      const corners = "#version 300 es\nvoid main() { gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 2 * (gl_VertexID & 2) - 1, 0, 1); }";
      for (const [kind, code] of [[gl.VERTEX_SHADER, corners], [gl.FRAGMENT_SHADER, text]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, code);
        gl.compileShader(shader);
        gl.attachShader(program, shader);
      }
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS))
        throw new Error(gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join("") + gl.getProgramInfoLog(program));
      const set = {};
      for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); ++i) {
        const { name: full, type } = gl.getActiveUniform(program, i), place = gl.getUniformLocation(program, full);
        set[full.replace("[0]", "")] = (value) => SETTERS[type](gl, place, value);
      }
      this.programs.set(name, { program, set });
    }
    const { program, set } = this.programs.get(name);
    gl.useProgram(program);
    [[gl.TEXTURE_3D, this.coefficients, "coefficients"], [gl.TEXTURE_3D, this.worth, "worth"], [gl.TEXTURE_2D, this.pieces, "pieces"]].forEach(
      ([kind, texture, of], unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(kind, texture);
        set[of]?.(unit);
      },
    );
    return set;
  }

  /**
   * Sets everything for a picture of this size; `cut`: a plane beside the look's own. At rest coarse samplers' weights are not used,
   * and surfaces are looked for twice as often, so that rays miss no thin ridge.
   */
  prepare(camera, width, height, cut, rest) {
    const rays = camera.rays(width, height);
    if (rest && look.mode === "surfaces") rays.planes[3] /= 2;
    const lights = camera.lights(), cuts = [...look.cuts, ...(cut ? [cut] : [])], colors = look.surfaces.map((one) => one[1]);
    const filled = (rows, most) => [...rows.flat(), ...Array(most * rows[0].length - rows.flat().length).fill(0)];
    const values = {
      ...rays, ...look.uniforms, extent: this.size, byHand: rest && this.coarse, pictureHeight: height,
      count: look.pieces.length, background: look.background, directed: lights.length,
      lights: filled(lights.length ? lights.map(([way]) => way) : [[0, 0, 0]], 4),
      lightColors: filled(lights.length ? lights.map(([, color]) => color) : [[0, 0, 0]], 4),
      cuts: filled(cuts.length ? cuts : [[0, 0, 0, 0]], MOST_CUTS), cutCount: cuts.length,
      isovalues: filled(look.surfaces.length ? look.surfaces.map(([value]) => [value]) : [[0]], 8),
      colors: filled(colors.length ? colors : [[0, 0, 0, 0]], 8), surfaces: colors.length,
      sign_: look.mode === "minip" ? -1 : 1, seenAbove: 0,
    };
    const set = this.program("ray.glsl");
    for (const name in set) if (name in values) set[name](values[name]);
  }

  /** A whole picture at once. */
  draw(camera, width, height, cut) {
    const { gl, canvas } = this;
    this.prepare(camera, width, height, cut, false);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** A picture in strips, between which the browser stays alive; returns false if `stale` says that nobody wants it any more. */
  async drawn(camera, width, height, cut, stale) {
    const { gl, canvas } = this, [target, rows] = this.target(width, height);
    let strip = 16;
    for (let y = 0; y < height && !stale(); ) {
      const some = Math.min(strip, height - y), begun = performance.now();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      this.prepare(camera, width, height, cut, true);
      gl.viewport(0, 0, width, height);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, y, width, some);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.disable(gl.SCISSOR_TEST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      y += some;
      await this.done();
      strip = Math.max(4, Math.min(2 * strip, Math.round((strip * STRIP_MS) / Math.max(1, performance.now() - begun))));
    }
    const kept = !stale();
    if (kept) {
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }
    gl.deleteFramebuffer(target);
    gl.deleteTexture(rows);
    return kept;
  }

  /** When the device has done what it was asked for. */
  done() {
    const { gl } = this, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    return new Promise((next) => {
      const ask = () => {
        if (!gl.isContextLost() && gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return void setTimeout(ask, 1);
        gl.deleteSync(fence);
        next();
      };
      setTimeout(ask, 0);
    });
  }

  /** The pixels of a slice, the top row first. */
  slice(corner, right, down, width, height) {
    const { gl } = this, [target, texture] = this.target(width, height), pixels = new Uint8ClampedArray(4 * width * height);
    const values = { corner, right, down, sliceSize: [width, height], window_: look.window, extent: this.size, byHand: true, count: look.pieces.length };
    const set = this.program("slice.glsl");
    for (const name in set) if (name in values) set[name](values[name]);
    gl.viewport(0, 0, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(texture);
    return new ImageData(pixels, width, height);
  }
}

const MOST_CUTS = 17;
const PROBES = 64;
const STRIP_MS = 30;
const SETTERS = {
  0x1406: (gl, at, v) => gl.uniform1fv(at, [v].flat()), 0x8b50: (gl, at, v) => gl.uniform2fv(at, v),
  0x8b51: (gl, at, v) => gl.uniform3fv(at, v), 0x8b52: (gl, at, v) => gl.uniform4fv(at, v),
  0x8b5b: (gl, at, v) => gl.uniformMatrix3fv(at, true, v), 0x1404: (gl, at, v) => gl.uniform1i(at, v),
  0x8b56: (gl, at, v) => gl.uniform1i(at, +v), 0x8b5e: (gl, at, v) => gl.uniform1i(at, v), 0x8b5f: (gl, at, v) => gl.uniform1i(at, v),
};
