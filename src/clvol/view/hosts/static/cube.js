// -- the cube that is turned like the world, and views from its faces ---------------------------------------------

const CUBE = 16; // CSS pixels, half an edge
const SIDES = ["Left", "Right", "Posterior", "Anterior", "Superior", "Inferior"]; // of a patient, towards +x, -x, +y, ...

/** The six faces of the world: name, title, and normal. */
function facesOf(space) {
  return [0, 1, 2].flatMap((axis) =>
    [1, -1].map((sign, i) => {
      const side = space === "LPS" ? SIDES[2 * axis + i] : `${sign < 0 ? "\u2212" : "+"}${"xyz"[axis]}`;
      const normal = [0, 1, 2].map((k) => (k === axis ? sign : 0));
      return { name: side, short: space === "LPS" ? side[0] : side, title: `look from ${side.toLowerCase()}`, normal };
    }),
  );
}

/** The faces of the cube that are seen: `right` and `down` are what runs so in the picture. */
function cubeOf(space, right, down, look) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const forward = [0, 1, 2].map((i) => right[(i + 1) % 3] * down[(i + 2) % 3] - right[(i + 2) % 3] * down[(i + 1) % 3]);
  const at = (point) => [CUBE * (2 + dot(point, right)), CUBE * (2 + dot(point, down))];
  const seen = facesOf(space).filter(({ normal }) => dot(normal, forward) < -1e-3);
  const parts = seen.map(({ short: name, title, normal }) => {
    const [one, other] = [0, 1, 2].filter((k) => !normal[k]);
    const corner = (a, b) => normal.map((c, k) => (k === one ? a : k === other ? b : c));
    const points = [corner(1, 1), corner(1, -1), corner(-1, -1), corner(-1, 1)].map((c) => at(c).join(",")).join(" ");
    const [x, y] = at(normal);
    const share = -dot(normal, forward);
    const pressed = (event) => {
      event.stopPropagation(); // it turns nothing
      event.preventDefault();
      look(normal);
    };
    const text = share > 0.4 ? make("text", { x, y, "font-size": 15 * share }, name) : null;
    return make("g", { class: "clvol-side", onpointerdown: pressed }, make("title", {}, title), make("polygon", { points }), text);
  });
  return make("svg", { class: "clvol-cube", width: 4 * CUBE, height: 4 * CUBE }, ...parts);
}
