// Vectors, and the camera: what a drag, a wheel and keys do to it, and its rays in samples.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const times = (a, k) => a.map((v) => v * k);
const length = (a) => Math.hypot(...a);
const apply = (m, v) => [dot(m.slice(0, 3), v), dot(m.slice(3, 6), v), dot(m.slice(6), v)];   // rows of a matrix
const common = (a, b) => (b ? common(b, a % b) : a);   // divisor
const turned = (v, axis, angle) => {
  const [x, y, z] = axis, c = Math.cos(angle), s = Math.sin(angle);
  const across = [y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]];
  return plus(plus(times(v, c), across, s), axis, dot(axis, v) * (1 - c));
};

class Camera {
  constructor() { this.reset(); }

  reset() { Object.assign(this, structuredClone(look.camera), { zoom: 1 }); }

  /** Turns about the vertical and about the horizontal of the picture, no further than straight from above or below. */
  turn(azimuth, elevation) {
    const all = (axis, angle) => {
      for (const name of ["right", "up", "forward"]) this[name] = turned(this[name], axis, angle);
      this.eye = plus(this.target, turned(plus(this.eye, this.target, -1), axis, angle));
    };
    all(this.pole, azimuth);
    const now = Math.asin(Math.max(-1, Math.min(1, -dot(this.forward, this.pole))));
    all(this.right, Math.max(-Math.PI / 2, Math.min(Math.PI / 2, now + elevation)) * -1 + now);
  }

  /** Half of the height that is seen, in the world; in perspective at distance 1. */
  halfHeight(aspect) { return this.half / this.zoom / (this.orthographic ? Math.min(1, aspect) : 1); }

  /** Where the eye is: in perspective further away from a portrait, whose width must hold what is seen. */
  eyeFor(aspect) {
    const rows = this.portraits, at = Math.max(0, Math.min(1, aspect) * rows.length - 1), k = Math.min(Math.floor(at), rows.length - 2);
    const [back, up] = plus(rows[k], plus(rows[k + 1], rows[k], -1), at - k);
    return plus(plus(this.eye, this.forward, -back / Math.min(1, aspect)), this.up, up);
  }

  /** Moves by shares of the picture's height. */
  pan(x, y, aspect) {
    const away = this.orthographic ? 1 : dot(plus(this.target, this.eyeFor(aspect), -1), this.forward);
    const by = plus(times(this.right, -2 * x), this.up, 2 * y).map((v) => v * this.halfHeight(aspect) * away);
    this.eye = plus(this.eye, by);
    this.target = plus(this.target, by);
  }

  /** Rays and the planes of samples for a picture: see clvol's scene/camera.py and march/planes.py. */
  rays(width, height) {
    const { toIndex, origin, center, unit, size, step } = look, aspect = width / height, half = this.halfHeight(aspect), eye = this.eyeFor(aspect);
    const away = plus(center, eye, -1), distance = dot(away, this.forward);
    const right = times(this.right, half * aspect), up = times(this.up, half), corner = plus(up, right, -1);
    const perX = times(right, 2 / width), perY = times(up, -2 / height);
    const inside = (v) => apply(toIndex, v), spread = this.orthographic ? 1 : distance, fan = this.orthographic ? 0 : unit;
    const start = inside(plus(plus(eye, this.forward, distance), origin, -1));
    const forward = inside(this.forward);
    const axis = [0, 1, 2].reduce((a, b) => (Math.abs(forward[b]) > Math.abs(forward[a]) ? b : a));
    let cosine = 1;
    for (const a of [-1, 1])
      for (const b of [-1, 1]) {
        const ray = inside(this.orthographic ? this.forward : plus(plus(this.forward, right, a), up, b));
        cosine = Math.min(cosine, ray[axis] * forward[axis] < 0 ? 0 : Math.abs(ray[axis]) / length(ray));
      }
    const count = Math.max(1, Math.ceil(size[axis] / (step * Math.max(cosine, 0.5)) - 1e-9)), spacing = size[axis] / count;
    const shared = common(size[axis], count), off = look.names && (size[axis] / shared) % 2 === 0 ? (0.5 * shared) / count : 0;
    return {
      origin: plus(start, inside(corner), spread), originU: times(inside(perX), spread), originV: times(inside(perY), spread),
      direction: plus(times(forward, unit), inside(corner), fan), directionU: times(inside(perX), fan), directionV: times(inside(perY), fan),
      eyeAt: distance / unit, orthographic: this.orthographic, planeCount: count, axis,
      planes: [-0.5 + 0.5 * spacing + off, size[axis] - 0.5 - 0.5 * spacing + off, spacing, step],
    };
  }

  /** The lights in the world: direction and colour. */
  lights() {
    return look.lights.map(([way, color, ofCamera]) => {
      const [x, y, z] = way;
      return [ofCamera ? plus(plus(times(this.right, x), this.up, y), this.forward, -z) : way, color];
    });
  }
}
