// Rays from cell to cell: where the function first is on the other side of a value, exactly.
//
// Within a cell the function along a ray is one polynomial (along.cl), whose first root is found without a step (bernstein.cl).
// Between cells it may jump. A ray crosses the planes between cells at distances that follow from their numbers alone, so a cell
// gives the same answer wherever a walk begins: however rays are cut into segments, and whatever is skipped.
//
// Set before: COEFFICIENTS and what along.cl needs. Set by the host: BLOCK, cells along an edge of the finest blocks; JUMPS,
// whether the filter's function may jump between cells.

#include "spline/along.cl"
#include "spline/cell.cl"
#include "march/camera.cl"
#include "march/sample.cl"

// -- one axis ---------------------------------------------------------------------------------------------------

// Rays along an axis, in cells: where they begin, how many they cross a unit of t, and which they may be in.
typedef struct {
    real origin, direction, per_direction;
    mask up;            // towards larger numbers
    mask first, last;   // that the domain touches
} axis_t;

INLINE axis_t axis_along(real origin, real direction, float low, float high, const int halo)
{
    axis_t a;
    const float start = cell_origin(halo);
    a.origin = GRID_POSITION(origin, start);
    a.direction = direction * (float)GRID_SCALE;
    a.per_direction = 1.0f / choose(magnitude(a.direction) < 1e-12f, (real)(1e-12f), a.direction);
    a.up = a.per_direction > 0.0f;
    const float from = GRID_POSITION(low, start), to = GRID_POSITION(high, start);   // whole or half numbers, not negative
    a.first = (mask)((int)from);
    a.last = (mask)((int)to - ((float)(int)to == to));
    return a;
}

INLINE real plane_t_of(const axis_t *a, const mask plane) { return (to_real(plane) - a->origin) * a->per_direction; }

// Where the ray leaves a cell, and where it entered. The outer ones reach as far as the ray does.
INLINE real exit_of(const axis_t *a, const mask cell)
{
    const mask outer = (a->up & (cell >= a->last)) | (!a->up & (cell <= a->first));
    return choose(outer, NOWHERE, plane_t_of(a, cell + choose_whole(a->up, 1, 0)));
}

INLINE real entry_of(const axis_t *a, const mask cell)
{
    const mask outer = (a->up & (cell <= a->first)) | (!a->up & (cell >= a->last));
    return choose(outer, -NOWHERE, plane_t_of(a, cell + choose_whole(a->up, 0, 1)));
}

INLINE mask next_cell(const axis_t *a, const mask cell) { return cell + choose_whole(a->up, 1, -1); }

INLINE mask limit_cell(const axis_t *a, mask cell)
{
    cell = choose_whole(cell < a->first, a->first, cell);
    return choose_whole(cell > a->last, a->last, cell);
}

// The cell in which a ray is at t: that between whose planes t lies, however the position is rounded.
INLINE mask cell_at(const axis_t *a, const real t)
{
    const real far = MIN(MAX(madd(t, a->direction, a->origin), (real)(-1.0f)), (real)(2e9f));
    mask cell = limit_cell(a, to_mask(round_down(far)));
    cell = choose_whole(exit_of(a, cell) <= t, next_cell(a, cell), cell);
    cell = choose_whole(entry_of(a, cell) > t, cell - choose_whole(a->up, 1, -1), cell);
    return limit_cell(a, cell);
}

// How far into the cell the ray is at t.
INLINE real fraction_at(const axis_t *a, const mask cell, const real t)
{
    return MIN(MAX(madd(t, a->direction, a->origin) - to_real(cell), (real)(0.0f)), (real)(1.0f));
}

// -- three ------------------------------------------------------------------------------------------------------

typedef struct { axis_t x, y, z; } axes_t;
typedef struct { mask x, y, z; } cell_indices_t;

// Bounds of the function in the blocks of cells, one a lane.
INLINE void bounds_of(global const float2 *minmax, constant minmax_block *block, const cell_indices_t *cell, real *low, real *high)
{
    const int nx = block->blocks[0], ny = block->blocks[1], nz = block->blocks[2];
    const lane_masks_u x = { cell->x }, y = { cell->y }, z = { cell->z };
    lanes_u lows, highs;
    for (int i = 0; i < LANES; ++i) {
        const int bx = MIN(x.each[i] / BLOCK, nx - 1), by = MIN(y.each[i] / BLOCK, ny - 1), bz = MIN(z.each[i] / BLOCK, nz - 1);
        const float2 bound = minmax[((size_t)bz * ny + by) * nx + bx];
        lows.each[i] = bound.x;
        highs.each[i] = bound.y;
    }
    *low = lows.all;
    *high = highs.all;
}

// The function in these cells, on the rays from t to `until`.
INLINE void function_in_cells(COEFFICIENTS coefficients, const int4 extent, const axes_t *axes, const cell_indices_t *cell, real t,
                              real until, real q[COEFFICIENT_COUNT])
{
    const lane_masks_u x = { cell->x }, y = { cell->y }, z = { cell->z };
    cursor_t slices[LANES];
    for (int i = 0; i < LANES; ++i)
        slices[i] = cursor_at(coefficients, extent, x.each[i], y.each[i], z.each[i]);
    function_along(coefficients, extent, slices,
                   fraction_at(&axes->x, cell->x, t), fraction_at(&axes->x, cell->x, until),
                   fraction_at(&axes->y, cell->y, t), fraction_at(&axes->y, cell->y, until),
                   fraction_at(&axes->z, cell->z, t), fraction_at(&axes->z, cell->z, until), q);
}

// The first place past a jump where a sample of the function is on its far side, so that every pixel is lit from there.
INLINE real beyond_jump(COEFFICIENTS coefficients, const sample_t *sample, const float value, real t, const real length,
                        const real side, mask active)
{
#if JUMPS
    const real end = t + length;
    real further = 1e-7f * (magnitude(t) + sample->frame->geometry.high[0] + sample->frame->geometry.high[1] + sample->frame->geometry.high[2]);
    for (int i = 0; i < 24; ++i) {
        const real at = value_at(coefficients, sample, t, active);
        active &= (at < value) == (side < 0.0f);
        if (!any_lane(active))
            break;
        t = choose(active, MIN(t + further, end), t);
        further *= 2.0f;
    }
#endif
    return t;
}

// What a walk knows of its rays.
typedef struct {
    real hit;    // where the function first is on the other side, or NOWHERE
    real side;   // 1: not below the value so far; -1: below; 0: nothing was looked at yet
} walk_t;

// The active rays from t = `from` to `to`, within the domain and the clipping box: looks for the first place where the function
// changes sides of `value`. Gives the lanes that found it.
OUT_OF_LINE mask walk_rays(walk_t *walk, COEFFICIENTS coefficients, const sample_t *sample, global const float2 *minmax,
                           const float value, const real from, const real to, mask active)
{
    const ray_t *ray = sample->ray;
    constant frame_t *frame = sample->frame;
    constant geometry_block *geometry = &frame->geometry;
    const int halo = sample->extent.w;
    const axes_t axes = {
        axis_along(ray->origin.x, ray->direction.x, geometry->low[0], geometry->high[0], halo),
        axis_along(ray->origin.y, ray->direction.y, geometry->low[1], geometry->high[1], halo),
        axis_along(ray->origin.z, ray->direction.z, geometry->low[2], geometry->high[2], halo),
    };
    const real begin = MAX(from, ray->enter), end = MIN(to, ray->leave);
    active &= begin <= end;
    cell_indices_t cell = { cell_at(&axes.x, begin), cell_at(&axes.y, begin), cell_at(&axes.z, begin) };
    // the whole of the first cell, even what lies before: it is looked at as any other walk would
    real t = MAX(MAX(entry_of(&axes.x, cell.x), entry_of(&axes.y, cell.y)), MAX(entry_of(&axes.z, cell.z), ray->enter));
    real side = walk->side, held[COEFFICIENT_COUNT], held_from = t, held_length = (real)(0.0f);
    mask bracketed = NONE, jumped = NONE;
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        held[j] = (real)(0.0f);
    while (any_lane(active)) {
        const real exit_x = exit_of(&axes.x, cell.x), exit_y = exit_of(&axes.y, cell.y), exit_z = exit_of(&axes.z, cell.z);
        const real exit = MIN(MIN(exit_x, exit_y), exit_z), until = MIN(exit, ray->leave);
        // rays in cells that cannot hold the value move on first, until all that go on want theirs
        mask moving = active, wanted = active, found = NONE;
        real sign;
        if (frame->minmax.skipping) {
            real low, high;
            bounds_of(minmax, &frame->minmax, &cell, &low, &high);
            const mask passed = active & ((low > value) | (high < value));
            sign = choose(low > value, (real)(1.0f), (real)(-1.0f));
            if (any_lane(passed)) {
                moving = passed;
                wanted = NONE;
            }
        }
        if (any_lane(wanted)) {
            real q[COEFFICIENT_COUNT], start = (real)(0.0f), width = (real)(1.0f);
            function_in_cells(coefficients, sample->extent, &axes, &cell, t, until, q);
#pragma unroll
            for (int j = 0; j < COEFFICIENT_COUNT; ++j)
                q[j] -= value;
            sign = choose(q[0] < 0.0f, (real)(-1.0f), (real)(1.0f));
            const changes_t changes = changes_of(q);
            found = wanted & changes.once & !(side * sign < 0.0f);
            if (any_lane(found & changes.twice))
                found = first_change(q, found, &start, &width);
            copy_polynomial(held, q, found);
            held_from = choose(found, madd(start, until - t, t), held_from);
            held_length = choose(found, width * (until - t), held_length);
            bracketed |= found;
        }
        // the side changes between this cell and the one before where the function jumps, or by rounding
        const mask jump = moving & (side * sign < 0.0f);
        held_from = choose(jump, t, held_from);
        held_length = choose(jump, until - t, held_length);
        jumped |= jump;
        side = choose(moving & !jump, sign, side);
        active &= !(found | jump);
        moving &= active;
        cell.x = choose_whole(moving & (exit_x == exit), next_cell(&axes.x, cell.x), cell.x);
        cell.y = choose_whole(moving & (exit_y == exit), next_cell(&axes.y, cell.y), cell.y);
        cell.z = choose_whole(moving & (exit_z == exit), next_cell(&axes.z, cell.z), cell.z);
        t = choose(moving, exit, t);
        active &= !moving | (exit < end);
    }
    walk->side = side;
    if (any_lane(bracketed))
        walk->hit = choose(bracketed, madd(root_between(held, bracketed), held_length, held_from), walk->hit);
    if (any_lane(jumped))
        walk->hit = choose(jumped, beyond_jump(coefficients, sample, value, held_from, held_length, side, jumped), walk->hit);
    return bracketed | jumped;
}
