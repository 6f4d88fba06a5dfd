// The function along a ray: what a mode can query at a sample, for LANES rays at a time.
//
// Set by the host: PLANES (whether the rays of a tile share blended planes), CENTRAL (gradients by central differences), LABELS
// (whether values are labels, and what of them is solid: 1 what the transfer function shows, 2 what the isovalue bounds; 3 if each
// place has the value of the region that it lies in, region.cl),
// WINDOWED (whether only a brick of the volume's coefficients is resident: window.cl).

#include "base/lanes.cl"
#include "base/math.cl"
#include "base/vector.cl"
#include "base/transpose.cl"
#include "spline/filter.cl"
#include "spline/fetch.cl"
#include "spline/taps.cl"
#include "spline/pairs.cl"
#include "spline/cell.cl"
#include "spline/sides.cl"
#include "march/camera.cl"
#include "march/window.cl"
#include "march/missing.cl"
#include "transfer/ramp.cl"
#if LABELS == 3
#define LABEL scalar   // whole numbers
#define LABEL_BYTES 4
#include "spline/region.cl"
#endif

#if PLANES
#define RARE OUT_OF_LINE   // kept out of the loop over samples on planes
#include "march/plane.cl"
#else
#define RARE INLINE
typedef struct { int made, usable; } plane_t;
typedef struct { int nothing; } plane_sample_t;
#endif

// The samples being gathered. (An image cannot be a member: coefficients are passed separately.)
typedef struct {
    constant frame_t *frame;
    global const float4 *table;     // of the transfer function
    int4 extent;                    // of the coefficients
    const ray_t *ray;
    plane_t *plane;                 // that they lie on, if it is usable
    plane_sample_t *on_plane;       // where on it
    float number;                   // of the sample
    int apart;                      // whether some ray's sample lies on no plane (alone)
#if MISSING
    global const uchar *missing;    // where samples are; 0 once rays have ended
#endif
#if CAST
    const real *left;               // of each light, where a surface is shaded (cast.cl); 0 on rays to lights, which shade none
#endif
} sample_t;

// -- one ray ---------------------------------------------------------------------------------------------------

// The cell of a position on a ray. Whatever the rounding, all its taps, and those of the cells a sample away, are
// stored.
INLINE int stored_cell(int i, int first, int last) { return i < first ? first : i > last ? last : i; }

INLINE cell_t locate_stored(const sample_t *sample, float x, float y, float z)
{
    const int reach = TAPS + GRID_SCALE + PAIRED_VALUE;
    const int4 extent = sample->extent;
    cell_t c = locate(x, y, z, extent.w);
    c.x = stored_cell(c.x, STORED_FROM(sample->frame, 0) + GRID_SCALE, STORED_TO(sample->frame, extent, 0) - (WEIGHTS > reach ? WEIGHTS : reach));
    c.y = stored_cell(c.y, STORED_FROM(sample->frame, 1) + GRID_SCALE, STORED_TO(sample->frame, extent, 1) - reach);
    c.z = stored_cell(c.z, STORED_FROM(sample->frame, 2) + GRID_SCALE, STORED_TO(sample->frame, extent, 2) - reach);
    return c;
}

#if LABELS == 3

OUT_OF_LINE float value_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z)
{
    return (float)region_in(coefficients, sample->extent, locate_stored(sample, x, y, z));
}

INLINE gradient_t scaled_lead(const int winner, const float gradient[3])
{
    const float unit = 1.0f + (float)(winner < 0 ? -winner : winner);
    const gradient_t g = { unit * gradient[0], unit * gradient[1], unit * gradient[2] };
    return g;
}

// Of by how much the region there exceeds the next one; in units of the value, like its rounding error.
OUT_OF_LINE gradient_t gradient_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z)
{
    const cell_t c = locate_stored(sample, x, y, z);
    const region_taps_t taps = taps_around(coefficients, sample->extent, c);
    const int winner = region_in(coefficients, sample->extent, c);
    float gradient[3], both;
    lead_between(&taps, c, winner, region_beside(&taps, winner), gradient, &both);
    return scaled_lead(winner, gradient);
}

#else

RARE float value_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z)
{
    return sample_value(coefficients, sample->extent, locate_stored(sample, x, y, z));
}

// The value some stored coefficients away: the same fraction of another cell. (Adding to the position would round,
// and where the function jumps the neighbour would sometimes be wrong.)
RARE float value_beside(COEFFICIENTS coefficients, const int4 extent, cell_t c, int x, int y, int z)
{
    c.x += x; c.y += y; c.z += z;
    return sample_value(coefficients, extent, c);
}

#if LABELS

#if LABELS == 2
#define SOLID(sample, value) ((value) >= (sample)->frame->mode.isovalue)
#else
#define SOLID(sample, value) (!transparent(&(sample)->frame->transfer, (sample)->table, value, value))
#endif

// Labels are names, and their differences are meaningless: solid regions have a surface, and regions that touch have none between
// them. Differences are averaged over the neighbours across, 1 : 2 : 1, since the faces of voxels have few directions; they
// are in units of the value, like its rounding error.
RARE gradient_t gradient_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z)
{
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    const int4 extent = sample->extent;
    const cell_t c = locate_stored(sample, x, y, z);
    for (int k = -1; k <= 1; ++k)
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i) {
                const float value = value_beside(coefficients, extent, c, i, j, k);
                const float share = SOLID(sample, value) ? (float)((2 - i * i) * (2 - j * j) * (2 - k * k)) / 32.0f : 0.0f;
                g.x += i * share; g.y += j * share; g.z += k * share;
            }
    const float unit = 1.0f + fabs(value_beside(coefficients, extent, c, 0, 0, 0));
    g.x *= unit; g.y *= unit; g.z *= unit;
    return g;
}

#else

// Per sample, not per stored coefficient. Central differences step by one coefficient: half a sample on the hybrid's
// magnified grid, as in programs that load magnified volumes.
RARE gradient_t gradient_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z)
{
    gradient_t g;
    const int4 extent = sample->extent;
    const cell_t c = locate_stored(sample, x, y, z);
#if CENTRAL
    g.x = 0.5f * (value_beside(coefficients, extent, c, 1, 0, 0) - value_beside(coefficients, extent, c, -1, 0, 0));
    g.y = 0.5f * (value_beside(coefficients, extent, c, 0, 1, 0) - value_beside(coefficients, extent, c, 0, -1, 0));
    g.z = 0.5f * (value_beside(coefficients, extent, c, 0, 0, 1) - value_beside(coefficients, extent, c, 0, 0, -1));
#else
    float value;
    g = sample_gradient(coefficients, extent, c, &value);
#endif
    g.x *= GRID_SCALE; g.y *= GRID_SCALE; g.z *= GRID_SCALE;
    return g;
}

#endif
#endif

// -- LANES rays: anywhere on them ------------------------------------------------------------------------------

// Inactive lanes are not evaluated.
INLINE real value_at(COEFFICIENTS coefficients, const sample_t *sample, real t, mask active)
{
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u value = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            value.each[i] = value_one(coefficients, sample, x.each[i], y.each[i], z.each[i]);
    return value.all;
}

#if LABELS == 3

// The same at samples: in cells that are known to hold one name, that is the core's.
INLINE real name_at(COEFFICIENTS coefficients, global const ulong2 *sides, const sample_t *sample, real t, mask active)
{
    constant frame_t *frame = sample->frame;
    if (!frame->minmax.skipping)
        return value_at(coefficients, sample, t, active);
    const int4 extent = sample->extent;
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const float origin = cell_origin(extent.w);
    const mask x = to_mask(GRID_POSITION(p.x, origin)), y = to_mask(GRID_POSITION(p.y, origin)), z = to_mask(GRID_POSITION(p.z, origin));
    const int nx = frame->minmax.blocks[0] * BRICKS, ny = frame->minmax.blocks[1] * BRICKS, nz = frame->minmax.blocks[2] * BRICKS;
    const mask bx = (x - BLOCKS_FROM(frame, 0)) / SIDES_EDGE, by = (y - BLOCKS_FROM(frame, 1)) / SIDES_EDGE, bz = (z - BLOCKS_FROM(frame, 2)) / SIDES_EDGE;
    const mask known = active & (bx >= 0) & (by >= 0) & (bz >= 0) & (bx < nx) & (by < ny) & (bz < nz);
    const lane_masks_u looked = { known }, bits = { BIT_OF(x, y, z) };
    const lane_indices_u at = { (bz * ny + by) * nx + bx }, row = { (z + SPARED) * extent.y + y + SPARED }, column = { x + SPARED };
    lane_masks_u held = { ~NONE };
    lanes_u value = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (looked.each[i] && !(sides[at.each[i]].x >> bits.each[i] & 1)) {
            held.each[i] = 0;
            value.each[i] = coefficients[(size_t)row.each[i] * extent.x + column.each[i]];
        }
    const mask unknown = active & held.all;
    return any_lane(unknown) ? choose(unknown, value_at(coefficients, sample, t, unknown), value.all) : value.all;
}

#endif

// The gradient in world directions, in a unit (Medium.block) in which float holds its square.
INLINE real3 gradient_at(COEFFICIENTS coefficients, const sample_t *sample, real t, mask active)
{
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u gx = { (real)(0.0f) }, gy = gx, gz = gx;
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i]) {
            const gradient_t g = gradient_one(coefficients, sample, x.each[i], y.each[i], z.each[i]);
            gx.each[i] = g.x; gy.each[i] = g.y; gz.each[i] = g.z;
        }
    return transpose3(sample->frame->geometry.gradient, real3_of(gx.all, gy.all, gz.all));
}

// -- LANES rays: at the sample that is gathered ----------------------------------------------------------------

#if PLANES

// The lanes whose sample lies on no plane: the ends of rays, or the single sample of a ray between two planes.
INLINE mask off_planes(const sample_t *sample)
{
    const ray_t *ray = sample->ray;
    const float n = sample->number;
    return ENDPOINTS ? (ray->begin > n) | (ray->end < n) : sample->apart ? ray->alone : NONE;
}

INLINE real value_here(COEFFICIENTS coefficients, const sample_t *sample, real t, mask active)
{
    if (!sample->plane->usable)
        return value_at(coefficients, sample, t, active);
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const int axis = sample->frame->planes.axis;
    return plane_value(sample->plane, sample->on_plane, axis == 0 ? p.y : p.x, axis == 2 ? p.y : p.z);
}

INLINE real3 gradient_here(COEFFICIENTS coefficients, const sample_t *sample, real t, mask active)
{
    if (CENTRAL || !sample->plane->usable)
        return gradient_at(coefficients, sample, t, active);
    const real3 g = plane_gradient(sample->plane, sample->on_plane, coefficients);   // along u, along v, across
    const int axis = sample->frame->planes.axis;
    real3 gradient = transpose3(sample->frame->geometry.gradient,
                                axis == 0 ? real3_of(g.z, g.x, g.y) : axis == 1 ? real3_of(g.x, g.z, g.y) : g);
    const mask apart = active & off_planes(sample);
    if (any_lane(apart)) {
        const real3 own = gradient_at(coefficients, sample, t, apart);
        gradient = real3_of(choose(apart, own.x, gradient.x), choose(apart, own.y, gradient.y), choose(apart, own.z, gradient.z));
    }
    return gradient;
}

#else
#define value_here value_at
#define gradient_here gradient_at
#endif
