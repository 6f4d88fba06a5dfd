// What the file holds: the look as JSON, and the coefficients, compressed.

const HALO = 2;   // texels around the coefficients of the domain
const BRICK = 8;  // cells along the edges of a brick

const look = JSON.parse(document.getElementById("look").textContent);

/** The coefficients in their texture's order: high and low bytes side by side, with the halo that the boundary rule gives. */
async function decoded() {
  const packed = Uint8Array.from(atob(document.getElementById("coefficients").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const [xs, ys, zs] = look.halo, [nx, ny, nz] = look.stored, half = nx * ny * nz;
  const texels = new Uint8Array(2 * xs.length * ys.length * zs.length);
  let to = 0;
  for (const z of zs)
    for (const y of ys)
      for (const x of xs) {
        const outside = x < 0 || y < 0 || z < 0, from = (z * ny + y) * nx + x;
        texels[to++] = outside ? look.beyond >> 8 : bytes[from];
        texels[to++] = outside ? look.beyond & 255 : bytes[half + from];
      }
  return texels;
}

/** The least and the largest coefficient that any cell of a brick uses, side by side; the function stays between them. */
function boundsOf(texels, size) {
  const blocks = size.map((n) => Math.ceil(n / BRICK)), bounds = new Float32Array(2 * blocks[0] * blocks[1] * blocks[2]);
  const span = (b, n) => [Math.max(0, b * BRICK - 1), Math.min(n, (b + 1) * BRICK + 2)];
  let to = 0;
  for (let k = 0; k < blocks[2]; ++k)
    for (let j = 0; j < blocks[1]; ++j)
      for (let i = 0; i < blocks[0]; ++i) {
        const [x0, x1] = span(i, size[0]), [y0, y1] = span(j, size[1]), [z0, z1] = span(k, size[2]);
        let low = 65535, high = 0;
        for (let z = z0; z < z1; ++z)
          for (let y = y0; y < y1; ++y)
            for (let at = 2 * ((z * size[1] + y) * size[0] + x0), end = at + 2 * (x1 - x0); at < end; at += 2) {
              const value = 256 * texels[at] + texels[at + 1];
              if (value < low) low = value;
              if (value > high) high = value;
            }
        bounds[to++] = low - ROUNDED;   // samplers round
        bounds[to++] = high + ROUNDED;
      }
  return { blocks, bounds };
}
const ROUNDED = look.filter ? 4 : 0;

/** Whether some value from `low` to `high` has an opacity. */
const opaqueWithin = (low, high) => {
  const { pieces } = look;
  return pieces.some(([start, length, from, until], k) => {
    const end = k + 1 < pieces.length ? pieces[k + 1][0] : Infinity;
    return end > low && start <= high && (from[3] > 0 || until[3] > 0);
  });
};

/** How much there is to see in each brick: nothing up to 0, or of extremes up to the best so far. */
function worthOf({ bounds }) {
  const worth = new Float32Array(bounds.length / 2);
  for (let i = 0; i < worth.length; ++i) {
    const low = bounds[2 * i], high = bounds[2 * i + 1];
    if (look.mode === "mip") worth[i] = high;
    else if (look.mode === "minip") worth[i] = -low;
    else if (look.mode === "composite") worth[i] = opaqueWithin(low, high) ? 1 : 0;
    else worth[i] = look.surfaces.some(([value]) => value >= low && value <= high) ? 1 : 0;
  }
  return worth;
}
