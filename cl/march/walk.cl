// Rays from cell to cell: the exact first crossing of an isovalue, or all crossings of several, in order.
//
// Within a cell the function along a ray is one polynomial (along.cl), whose first root is found without a step (bernstein.cl).
// Between cells it may jump. A ray crosses the planes between cells at distances that depend only on their numbers, so a cell
// gives the same result wherever a walk begins: however rays are divided into segments, and whatever is skipped.
//
// The rays of a tile advance, packet by packet, until each is in a cell whose block may contain the isovalue. These are few, so
// the cells are then gathered from the whole tile, and searched LANES at a time; so are the roots that were found.
//
// A mode with STRETCHES supplies SOUGHT(frame, k), the isovalues in ascending order, SURFACES(frame), how many there are, and a
// state_t with
//   hit    the first crossing, or NOWHERE
//   side   of the part that was searched so far: 1 and how many isovalues it is not below; 0 if there is none
// Crossings at missing places (missing.cl) do not count: the search continues behind them. With LAYERED 1 it continues behind each
// crossing; the mode then also supplies
//   which  the number of the isovalue that is crossed there
//   pass_hit(state, coefficients, sample, active)
//          the crossing at `hit`, which becomes NOWHERE
// A crossing counts in the one stretch that it lies in, although cells are searched whole.
//
// Set by the host: BLOCK, cells along an edge of the finest blocks; JUMPS, whether the function may jump between cells.

#include "spline/along.cl"
#include "spline/sides.cl"
#include "march/segments.cl"

#define RAYS (PACKETS * LANES)
#define AHEAD (ADDED ? 0.5f : 0.0f)   // samples, by which stretches begin before their first one: added to media, half
#define LOOKS_ON (MISSING || LAYERED)   // whether the search may continue behind a crossing
#if CAST
#define PASSES(tile) ((tile)->light >= 0)   // whether rays pass through crossings, or stop there for light
#else
#define PASSES(tile) 1
#endif

// -- one axis ---------------------------------------------------------------------------------------------------

// Rays along an axis, in cells. Plane number n is before cell n. There are no cells outside the domain: rays stay in the outer
// ones, wherever they enter and leave.
typedef struct {
    real origin, direction, per_direction;   // at t = 0; cells per unit of t; units of t per cell
    mask up, ahead, step;   // whether towards larger numbers; 1 and 1 if so, else 0 and -1
    mask from, to;          // the first and the last plane on the way
} axis_t;

INLINE axis_t axis_along(real origin, real direction, float low, float high, const int halo)
{
    axis_t a;
    const float start = cell_origin(halo);
    a.origin = GRID_POSITION(origin, start);
    a.direction = direction * (float)GRID_SCALE;
    a.per_direction = 1.0f / choose(magnitude(a.direction) < 1e-12f, (real)(1e-12f), a.direction);
    a.up = a.per_direction > 0.0f;
    a.ahead = choose_whole(a.up, (mask)(1), NONE);
    a.step = 2 * a.ahead - 1;
    const float bottom = GRID_POSITION(low, start), top = GRID_POSITION(high, start);   // whole or half numbers, not negative
    const mask first = (mask)((int)bottom), past = (mask)((int)top + ((float)(int)top < top));
    // rays along the planes stay in one cell, even those on a plane
    const mask parallel = magnitude(a.direction) < 1e-12f, own = to_mask(MIN(MAX(a.origin, to_real(first)), to_real(past - 1)));
    a.from = choose_whole(parallel, own, choose_whole(a.up, first, past));
    a.to = choose_whole(parallel, own + 1, choose_whole(a.up, past, first));
    return a;
}

INLINE real plane_t_of(const axis_t *a, const mask plane) { return (to_real(plane) - a->origin) * a->per_direction; }

// Where rays leave a cell, and where they entered it.
INLINE real exit_of(const axis_t *a, const mask cell)
{
    const mask plane = cell + a->ahead;
    return choose(plane == a->to, NOWHERE, plane_t_of(a, plane));
}

INLINE real entry_of(const axis_t *a, const mask cell)
{
    const mask plane = cell + 1 - a->ahead;
    return choose(plane == a->from, -NOWHERE, plane_t_of(a, plane));
}

// Where they leave its brick.
INLINE real brick_exit_of(const axis_t *a, const mask cell)
{
    const mask plane = (cell & ~(SIDES_EDGE - 1)) + SIDES_EDGE * a->ahead;
    const mask outer = (a->up & (plane >= a->to)) | (!a->up & (plane <= a->to));
    return choose(outer, NOWHERE, plane_t_of(a, plane));
}

// The cell of a ray at t: the cell whose planes enclose t, whatever the rounding of the position.
INLINE mask cell_at(const axis_t *a, const real t)
{
    const mask bottom = choose_whole(a->up, a->from, a->to), top = choose_whole(a->up, a->to, a->from) - 1;
    const mask cell = to_mask(MIN(MAX(madd(t, a->direction, a->origin), to_real(bottom)), to_real(top)));
    return cell + choose_whole(exit_of(a, cell) <= t, a->step, choose_whole(entry_of(a, cell) > t, -a->step, NONE));
}

INLINE mask next_cell(const axis_t *a, const mask cell, const mask wanted) { return choose_whole(wanted, cell + a->step, cell); }

// How far into the cell the ray is at t.
INLINE real fraction_at(const axis_t *a, const mask cell, const real t)
{
    return MIN(MAX(madd(t, a->direction, a->origin) - to_real(cell), (real)(0.0f)), (real)(1.0f));
}

#if WINDOWED

// Where rays enter the cells of a window along an axis, if that is past `begin`, and leave them, if that is before `out`. The
// window's faces are planes between cells, so that each cell of a ray is traversed in exactly one window. A ray along the faces
// stays in one.
INLINE void keep_in_window(const axis_t *a, const ray_t *ray, const real direction, const int cells_from, const int cells_to,
                           real *begin, real *out, mask *active)
{
    const mask along = along_faces(ray, direction), own = cell_at(a, ray->enter);
    const mask first = choose_whole(a->up, a->from, a->to), past = choose_whole(a->up, a->to, a->from);
    const mask low = choose_whole(first > cells_from, first, NONE + cells_from), high = choose_whole(past < cells_to, past, NONE + cells_to);
    const mask into = choose_whole(a->up, low, high), beyond = choose_whole(a->up, high, low);
    *begin = MAX(*begin, choose(along | (into == a->from), -NOWHERE, plane_t_of(a, into)));
    *out = MIN(*out, choose(along | (beyond == a->to), NOWHERE, plane_t_of(a, beyond)));
    *active &= choose_whole(along, (own >= cells_from) & (own < cells_to), low < high);
}

#endif

// -- three ------------------------------------------------------------------------------------------------------

typedef struct { axis_t x, y, z; } axes_t;
typedef struct { mask x, y, z; } cells_t;

INLINE axes_t axes_along(const ray_t *ray, constant geometry_block *geometry, const int halo)
{
    const axes_t axes = {
        axis_along(ray->origin.x, ray->direction.x, geometry->low[0], geometry->high[0], halo),
        axis_along(ray->origin.y, ray->direction.y, geometry->low[1], geometry->high[1], halo),
        axis_along(ray->origin.z, ray->direction.z, geometry->low[2], geometry->high[2], halo),
    };
    return axes;
}

// The bounds of LANES cells: whether they may contain an isovalue; whether the function is above the only one there; whether that
// holds for the whole brick.
typedef struct { mask held, above, uniform; } sides_t;

// Whether the function is on another side.
INLINE mask differ(const real one, const real other) { return (one != other) & (one != 0.0f) & (other != 0.0f); }

// Numbers from 0 to `last`: lanes that are not active may be anywhere.
INLINE mask limit_whole(mask i, mask last) { return choose_whole(i > last, last, choose_whole(i < 0, NONE, i)); }

INLINE sides_t sides_of(global const ulong2 *sides, constant frame_t *frame, const cells_t *cell)
{
    constant minmax_block *block = &frame->minmax;
    const int nx = block->blocks[0] * BRICKS, ny = block->blocks[1] * BRICKS, nz = block->blocks[2] * BRICKS;
    const mask x = limit_whole((cell->x - BLOCKS_FROM(frame, 0)) / SIDES_EDGE, nx - 1);
    const mask y = limit_whole((cell->y - BLOCKS_FROM(frame, 1)) / SIDES_EDGE, ny - 1);
    const mask z = limit_whole((cell->z - BLOCKS_FROM(frame, 2)) / SIDES_EDGE, nz - 1);
    const lane_indices_u at = { (z * ny + y) * nx + x };
    const lane_masks_u bits = { BIT_OF(cell->x, cell->y, cell->z) };
    lane_masks_u known;
#if LANES > 1
#pragma unroll
#endif
    for (int i = 0; i < LANES; ++i) {
        const ulong2 brick = sides[at.each[i]];
        const int held = (int)(brick.x >> bits.each[i]) & 1, above = (int)(brick.y >> bits.each[i]) & 1;
        known.each[i] = held | above << 1 | ((brick.x == 0) & (LAYERED | (brick.y == 0) | (brick.y == ALL_CELLS))) << 2;
    }
    const sides_t s = { (known.all & 1) != 0, (known.all & 2) != 0, (known.all & 4) != 0 };
    return s;
}

// -- a tile -----------------------------------------------------------------------------------------------------

// A packet on its way through a stretch of its rays.
typedef struct {
    axes_t axes;
    cells_t cell;
    real t, until;        // where the rays enter their cells, and leave them
    real end;             // of the stretch
    mask active;
    lanes_u x, y, z, to_x, to_y, to_z;   // fractions of the cells there
    lanes_u side, sign;   // of the part searched; where this cell begins
#if LOOKS_ON
    lanes_u after;        // where it ends
#endif
#if LAYERED
    lanes_u from, to;     // the stretch
    lanes_u last;         // the last crossing
    lane_masks_u more;    // whether this cell may contain others
#endif
    lane_masks_u found;   // whether it contains a root
} walker_t;

// Starts rays on a stretch, and returns its length.
OUT_OF_LINE real set_out(walker_t *w, const ray_t *ray, const state_t *state, constant frame_t *frame, const int halo,
                    const real from, const real to, const mask active)
{
    real begin = MAX(MAX(from, ray->enter), LAST_OF(state));
    w->axes = axes_along(ray, &frame->geometry, halo);
    w->end = MIN(to, ray->leave);
    w->active = active & (begin <= w->end);
#if WINDOWED
    real out = NOWHERE;
    keep_in_window(&w->axes.x, ray, ray->direction.x, frame->window.cells_from[0], frame->window.cells_to[0], &begin, &out,
                   &w->active);
    keep_in_window(&w->axes.y, ray, ray->direction.y, frame->window.cells_from[1], frame->window.cells_to[1], &begin, &out,
                   &w->active);
    keep_in_window(&w->axes.z, ray, ray->direction.z, frame->window.cells_from[2], frame->window.cells_to[2], &begin, &out,
                   &w->active);
    w->end = MIN(w->end, out);
    w->active &= (begin <= w->end) & (begin < out);
#endif
    w->cell.x = cell_at(&w->axes.x, begin);
    w->cell.y = cell_at(&w->axes.y, begin);
    w->cell.z = cell_at(&w->axes.z, begin);
    // the whole first cell, even before the stretch: every walk searches it in the same way
    w->t = MAX(MAX(entry_of(&w->axes.x, w->cell.x), entry_of(&w->axes.y, w->cell.y)), MAX(entry_of(&w->axes.z, w->cell.z), ray->enter));
    w->side.all = state->side;
    w->found.all = NONE;
#if LAYERED
    w->from.all = from;
    w->to.all = to;
    w->last.all = LAST_OF(state);
#endif
    return choose(w->active, w->end - begin, (real)(0.0f));
}

// The first place past a jump at which a sample of the function is on the far side, so that every pixel is lit from there; the jump
// itself if there is none nearby.
INLINE real beyond_jump(COEFFICIENTS coefficients, const sample_t *sample, const real value, const real jump, const real end,
                        const mask rising, mask active)
{
#if JUMPS
    constant float *high = sample->frame->geometry.high;
    real t = jump, further = 1e-7f * (magnitude(t) + high[0] + high[1] + high[2]);
    for (int i = 0; i < 8; ++i) {
        active &= (value_at(coefficients, sample, t, active) < value) == (rising != 0);
        if (!any_lane(active))
            return t;
        t = choose(active, MIN(t + further, end), t);
        further *= 2.0f;
    }
    return choose(active, jump, t);
#else
    return jump;
#endif
}

#if MISSING
// Where the side changes between two cells, it is the place just past their border that may be missing.
INLINE real past_border(const real t, const real length) { return madd(1e-3f, length, t); }
#endif
#if LOOKS_ON
#define SIDE_AFTER(w) (w)->after
#else
#define SIDE_AFTER(w) (w)->sign
#endif

// The number of the first isovalue that is crossed from one side to another.
INLINE real crossed_between(const real side, const real sign) { return side - choose(side < sign, (real)(1.0f), (real)(2.0f)); }

INLINE real sought_of(constant frame_t *frame, const real which)
{
    real value = (real)(SOUGHT(frame, 0));
    for (int k = 1; k < SURFACES(frame); ++k)
        value = choose(which == (real)(k), (real)(SOUGHT(frame, k)), value);
    return value;
}

// Advances rays to cells that may contain the isovalue. `looked`: whether their present cells were searched.
OUT_OF_LINE void go_on(walker_t *w, state_t *state, COEFFICIENTS coefficients, const sample_t *sample, global const ulong2 *sides,
                  int looked)
{
    const ray_t *ray = sample->ray;
    const axes_t *axes = &w->axes;
    w->active &= !w->found.all;
    for (;; looked = 0) {
        const real exit_x = exit_of(&axes->x, w->cell.x), exit_y = exit_of(&axes->y, w->cell.y), exit_z = exit_of(&axes->z, w->cell.z);
        real exit = MIN(MIN(exit_x, exit_y), exit_z);
        w->until = MIN(exit, ray->leave);
        mask passed = w->active, far = NONE;
        if (!looked) {
            if (!(sample->frame->minmax.skipping & !(LAYERED & JUMPS)))
                return;   // any may
            const sides_t known = sides_of(sides, sample->frame, &w->cell);
            // of several isovalues it is that of the cell before: between cells that may contain none the function does not jump
            SIDE_AFTER(w).all = w->sign.all = LAYERED ? w->side.all : choose(known.above, (real)(2.0f), (real)(1.0f));
            passed &= !known.held;
            far = passed & known.uniform;
            if (any_lane(far))
                exit = choose(far, MIN(MIN(brick_exit_of(&axes->x, w->cell.x), brick_exit_of(&axes->y, w->cell.y)), brick_exit_of(&axes->z, w->cell.z)), exit);
        }
        if (!any_lane(passed))
            return;
        // sides change from one cell to the next where the function jumps, or by rounding
        mask changed = passed & differ(w->side.all, w->sign.all);
#if MISSING
        changed &= !missing_at(sample->missing, sample->frame, ray, past_border(w->t, w->until - w->t), changed);
#endif
        real after = SIDE_AFTER(w).all;
        if (any_lane(changed)) {
            const mask rising = w->side.all < w->sign.all;
            const real which = crossed_between(w->side.all, w->sign.all);
            const real t = beyond_jump(coefficients, sample, sought_of(sample->frame, which), w->t, w->until, rising, changed);
            state->hit = choose(changed, t, state->hit);
#if LAYERED
            state->which = choose(changed, which, state->which);
            after = choose(changed, w->side.all + choose(rising, (real)(1.0f), (real)(-1.0f)), after);
#endif
        }
        w->side.all = choose(passed, after, w->side.all);
#if LOOKS_ON
        // the next stretch searches a cell that a ray stops in once more, from its beginning
        w->side.all = choose(passed & !changed & !(exit < w->end) & (w->sign.all != w->after.all), (real)(0.0f), w->side.all);
#endif
        passed &= !changed;
        w->active &= !changed & (!passed | (exit < w->end));
        const mask near = passed & !far;
        w->cell.x = next_cell(&axes->x, w->cell.x, near & (exit_x == exit));
        w->cell.y = next_cell(&axes->y, w->cell.y, near & (exit_y == exit));
        w->cell.z = next_cell(&axes->z, w->cell.z, near & (exit_z == exit));
        far &= passed;
        if (any_lane(far)) {
            w->cell.x = choose_whole(far, cell_at(&axes->x, exit), w->cell.x);
            w->cell.y = choose_whole(far, cell_at(&axes->y, exit), w->cell.y);
            w->cell.z = choose_whole(far, cell_at(&axes->z, exit), w->cell.z);
        }
        w->t = choose(passed, exit, w->t);
    }
}

// Roots to be refined, LANES of them at a time.
typedef struct {
    int count, ray[LANES];
    lanes_u from, length, q[COEFFICIENT_COUNT];
} roots_t;

OUT_OF_LINE void refine_roots(roots_t *roots, walker_t *walkers, state_t *states)
{
    real q[COEFFICIENT_COUNT];
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        q[j] = roots->q[j].all;
    const lanes_u hit = { madd(root_between(q), roots->length.all, roots->from.all) };
    for (int i = 0; i < roots->count; ++i) {
        state_t *state = states + roots->ray[i] / LANES;
        const int lane = roots->ray[i] % LANES;
        lanes_u hits = { state->hit };
#if LAYERED
        walker_t *w = walkers + roots->ray[i] / LANES;
        if (hit.each[i] <= w->last.each[lane] || hit.each[i] < w->from.each[lane] || hit.each[i] >= w->to.each[lane]) {
            w->found.each[lane] = 0;
            continue;
        }
#endif
        hits.each[lane] = hit.each[i];
        state->hit = hits.all;
    }
    roots->count = 0;
}

#if MISSING

#define LOOKED_ALONG , const tile_t *tile MISSING_TOO
#define LOOKING_ALONG , tile AND_MISSING

// The lines of some rays of a tile, side by side.
INLINE ray_t lines_of(const tile_t *tile, const int *rays, const int count)
{
    lanes_u ox, oy, oz, dx, dy, dz;
    for (int i = 0; i < LANES; ++i) {
        const int ray = rays[i < count ? i : 0], lane = ray % LANES;
        const real3 origin = tile->rays[ray / LANES].origin, direction = tile->rays[ray / LANES].direction;
        const lanes_u ax = { origin.x }, ay = { origin.y }, az = { origin.z };
        const lanes_u bx = { direction.x }, by = { direction.y }, bz = { direction.z };
        ox.each[i] = ax.each[lane]; oy.each[i] = ay.each[lane]; oz.each[i] = az.each[lane];
        dx.each[i] = bx.each[lane]; dy.each[i] = by.each[lane]; dz.each[i] = bz.each[lane];
    }
    ray_t lines;
    lines.origin = real3_of(ox.all, oy.all, oz.all);
    lines.direction = real3_of(dx.all, dy.all, dz.all);
    return lines;
}

#else
#define LOOKED_ALONG
#define LOOKING_ALONG
#endif

#if LOOKS_ON

INLINE void less(real p[COEFFICIENT_COUNT], const real q[COEFFICIENT_COUNT], const float value)
{
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        p[j] = q[j] - value;
}

#if MISSING
#define AT_MISSING(t, active) missing_at(missing, frame, lines, t, active)
#else
#define AT_MISSING(t, active) NONE
#endif

// The first crossing past `last` and `begun`, before `to` and at no missing place, of polynomials on stretches of these rays; lanes
// that have none are left out of the result. `hit` is where it is.
OUT_OF_LINE mask first_shown(const real polynomial[COEFFICIENT_COUNT], const ray_t *lines, const real from, const real length,
                             const real last, const real begun, const real to, mask active, constant frame_t *frame,
                             real *hit MISSING_TOO)
{
    real rest[COEFFICIENT_COUNT], before[COEFFICIENT_COUNT];
    real begin = (real)(0.0f), share = (real)(1.0f);   // of the stretch, the rest that is still to be searched
    mask found = NONE;
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        rest[j] = polynomial[j];
    while (any_lane(active)) {
        real q[COEFFICIENT_COUNT], start, width;
#pragma unroll
        for (int j = 0; j < COEFFICIENT_COUNT; ++j)
            q[j] = rest[j];
        active &= first_change(q, active, &start, &width);
        const real place = madd(madd(root_between(q), width, start), share, begin), t = madd(place, length, from);
        const mask hidden = AT_MISSING(t, active) | (t <= last) | (t < begun) | (t >= to), shown = active & !hidden;
        *hit = choose(shown, t, *hit);
        found |= shown;
        const real past = start + width;   // where the part ends that has this root alone
        active &= hidden & (past < 1.0f);
        split_at(rest, choose(active, past, (real)(0.5f)), before);
        begin = choose(active, madd(past, share, begin), begin);
        share = choose(active, share * (1.0f - past), share);
    }
    return found;
}

#endif

// Searches the cells of some rays.
OUT_OF_LINE void look_into(walker_t *walkers, const int *rays, const int count, COEFFICIENTS coefficients, const int4 extent,
                           constant frame_t *frame, roots_t *roots, state_t *states LOOKED_ALONG)
{
#if LAYERED
    lanes_u last, begun, to;
#endif
    lanes_u x, y, z, to_x, to_y, to_z, from, length, side;
    cursor_t slices[LANES];
    lane_masks_u active;
    for (int i = 0; i < LANES; ++i) {
        const int ray = rays[i < count ? i : 0], lane = ray % LANES;
        walker_t *w = walkers + ray / LANES;
        const lane_masks_u cx = { w->cell.x }, cy = { w->cell.y }, cz = { w->cell.z };
        const lanes_u t = { w->t }, until = { w->until };
        slices[i] = cursor_at(coefficients, extent, cx.each[lane], cy.each[lane], cz.each[lane]);
        x.each[i] = w->x.each[lane]; y.each[i] = w->y.each[lane]; z.each[i] = w->z.each[lane];
        to_x.each[i] = w->to_x.each[lane]; to_y.each[i] = w->to_y.each[lane]; to_z.each[i] = w->to_z.each[lane];
        from.each[i] = t.each[lane];
        length.each[i] = until.each[lane] - t.each[lane];
        side.each[i] = w->side.each[lane];
        active.each[i] = i < count ? -1 : 0;
#if LAYERED
        last.each[i] = w->last.each[lane];
        begun.each[i] = w->from.each[lane];
        to.each[i] = w->to.each[lane];
#endif
    }
    real q[COEFFICIENT_COUNT];
    function_along(coefficients, extent, slices, x.all, to_x.all, y.all, to_y.all, z.all, to_z.all, q);
    lanes_u sign = { (real)(1.0f) };
#if LOOKS_ON
    lanes_u end = sign, hit = { NOWHERE }, which = { (real)(0.0f) };
    for (int k = 0; k < SURFACES(frame); ++k) {
        sign.all += choose(q[0] - SOUGHT(frame, k) < 0.0f, (real)(0.0f), (real)(1.0f));
        end.all += choose(q[BERNSTEIN_DEGREE] - SOUGHT(frame, k) < 0.0f, (real)(0.0f), (real)(1.0f));
    }
    mask jumps = (active.all != 0) & differ(side.all, sign.all);
#if MISSING
    const ray_t lines = lines_of(tile, rays, count);
    jumps &= !missing_at(missing, frame, &lines, past_border(from.all, length.all), jumps);
#define ALONG_LINES &lines
#else
#define ALONG_LINES 0
#endif
#if LAYERED
#define STILL_SOUGHT last.all, begun.all, to.all
#else
#define STILL_SOUGHT -NOWHERE, -NOWHERE, NOWHERE
#endif
    lane_masks_u found = { NONE }, alone = found;   // a crossing; whether it is the only one of the cell
    for (int k = 0; k < SURFACES(frame); ++k) {
        real p[COEFFICIENT_COUNT];
        changes_t changes;
        less(p, q, SOUGHT(frame, k));
        changes = changes_of(p);
        which.all = choose(changes.once, (real)(k), which.all);
        alone.all = (alone.all & !changes.once) | (changes.once & !changes.twice & !found.all);
        found.all |= changes.once;
    }
    found.all &= !jumps & (active.all != 0);
    alone.all &= MISSING ? NONE : found.all;
    const mask several = found.all & !alone.all;
    if (any_lane(several)) {
        found.all = alone.all;
        for (int k = 0; k < SURFACES(frame); ++k) {
            real p[COEFFICIENT_COUNT], t = NOWHERE;
            less(p, q, SOUGHT(frame, k));
            mask crossed = changes_of(p).once & several;
            if (any_lane(crossed))
                crossed = first_shown(p, ALONG_LINES, from.all, length.all, STILL_SOUGHT, crossed, frame, &t AND_MISSING);
            crossed &= t < hit.all;
            hit.all = choose(crossed, t, hit.all);
            which.all = choose(crossed, (real)(k), which.all);
            found.all |= crossed;
        }
    }
    for (int i = 0; i < count; ++i) {
        const int lane = rays[i] % LANES;
        walker_t *w = walkers + rays[i] / LANES;
        state_t *state = states + rays[i] / LANES;
        w->sign.each[lane] = sign.each[i];
        w->after.each[lane] = end.each[i];
        if (!found.each[i])
            continue;
        w->found.each[lane] = found.each[i];
#if LAYERED
        lanes_u numbers = { state->which };
        numbers.each[lane] = which.each[i];
        state->which = numbers.all;
        w->more.each[lane] = alone.each[i] ? 0 : -1;
        if (alone.each[i]) {
            for (int j = 0; j < COEFFICIENT_COUNT; ++j) {
                const lanes_u coefficient = { q[j] };
                roots->q[j].each[roots->count] = coefficient.each[i] - SOUGHT(frame, (int)which.each[i]);
            }
            roots->from.each[roots->count] = from.each[i];
            roots->length.each[roots->count] = length.each[i];
            roots->ray[roots->count] = rays[i];
            if (++roots->count == LANES)
                refine_roots(roots, walkers, states);
            continue;
        }
#endif
        lanes_u hits = { state->hit };
        hits.each[lane] = hit.each[i];
        state->hit = hits.all;
    }
#else
    real start = (real)(0.0f), width = (real)(1.0f);
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        q[j] -= SOUGHT(frame, 0);
    sign.all += choose(q[0] < 0.0f, (real)(0.0f), (real)(1.0f));
    const changes_t changes = changes_of(q);
    lane_masks_u found = { changes.once & !differ(side.all, sign.all) & (active.all != 0) };
    if (any_lane(found.all & changes.twice))
        found.all = first_change(q, found.all, &start, &width);
    const lanes_u begin = { madd(start, length.all, from.all) }, part = { width * length.all };
    for (int i = 0; i < count; ++i) {
        walker_t *w = walkers + rays[i] / LANES;
        w->sign.each[rays[i] % LANES] = sign.each[i];
        if (!found.each[i])
            continue;
        w->found.each[rays[i] % LANES] = found.each[i];
        for (int j = 0; j < COEFFICIENT_COUNT; ++j) {
            const lanes_u coefficient = { q[j] };
            roots->q[j].each[roots->count] = coefficient.each[i];
        }
        roots->from.each[roots->count] = begin.each[i];
        roots->length.each[roots->count] = part.each[i];
        roots->ray[roots->count] = rays[i];
        if (++roots->count == LANES)
            refine_roots(roots, walkers, states);
    }
#endif
}

#if LAYERED

// Rays of a packet pass through the crossings that were found. Returns those that must be searched again where they are.
OUT_OF_LINE mask pass_hits(walker_t *w, state_t *state, COEFFICIENTS coefficients, const sample_t *sample)
{
    const mask met = state->hit < NOWHERE;
    if (!any_lane(met))
        return NONE;
    const mask jumped = met & !w->found.all;   // in front of their cells
    w->last.all = choose(met, state->hit, w->last.all);
    w->found.all = NONE;
    pass_hit(state, coefficients, sample, met);
    const mask on = met & !finished(state, sample->frame), again = on & (w->more.all | jumped);
    w->active = (w->active & !met) | (on & !again);
    return again;
}

#endif

// Walks the rays of a tile from sample number start to stop, and all between them.
OUT_OF_LINE void walk_segment(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, global const ulong2 *sides,
                              constant frame_t *frame, global const float4 *table, const mask wanted[PACKETS], const float start,
                              const float stop MISSING_TOO)
{
    walker_t walkers[PACKETS];
    roots_t roots;
    int rays[RAYS + 1], looked = 0;
    const int passing = PASSES(tile);
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    roots.count = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const ray_t *ray = tile->rays + g;
        walkers[g].active = wanted[g];
        if (!any_lane(wanted[g]))
            continue;
        const real length = set_out(walkers + g, ray, tile->states + g, frame, extent.w, madd(start - AHEAD, ray->step, ray->first),
                                    madd(stop + 1.0f - AHEAD, ray->step, ray->first), wanted[g]);
        const mask counted = wanted[g] & (LAST_OF(tile->states + g) < madd(start - AHEAD, ray->step, ray->first));   // and not before
        const real samples = MIN((real)(stop), ray->end + MARGIN) - MAX((real)(start), ray->begin - MARGIN) + 1.0f;
        tile->gathered[g] += choose(counted, WINDOWED ? choose(ray->step > 0.0f, MIN(length / ray->step, samples), (real)(1.0f)) : samples, (real)(0.0f));
    }
    for (;;) {
        int count = 0, met = 0;
        for (int g = 0; g < PACKETS; ++g) {
            walker_t *w = walkers + g;
            state_t *state = tile->states + g;
            if (!any_lane(w->active | (LAYERED & passing ? wanted[g] & (state->hit < NOWHERE) : NONE)))
                continue;
            const sample_t sample = { frame, table, extent, tile->rays + g, &none, 0, 0.0f, 0 AND_MISSING };
#if LAYERED
            const mask again = passing ? pass_hits(w, state, coefficients, &sample) : NONE;
#endif
            go_on(w, state, coefficients, &sample, sides, looked);
#if LAYERED
            w->active |= again;
            met |= passing && any_lane(state->hit < NOWHERE);
#endif
            w->x.all = fraction_at(&w->axes.x, w->cell.x, w->t);
            w->y.all = fraction_at(&w->axes.y, w->cell.y, w->t);
            w->z.all = fraction_at(&w->axes.z, w->cell.z, w->t);
            w->to_x.all = fraction_at(&w->axes.x, w->cell.x, w->until);
            w->to_y.all = fraction_at(&w->axes.y, w->cell.y, w->until);
            w->to_z.all = fraction_at(&w->axes.z, w->cell.z, w->until);
            const lane_masks_u active = { w->active };
            for (int i = 0; i < LANES; ++i) {
                rays[count] = g * LANES + i;   // written if it is active
                count += active.each[i] != 0;
            }
        }
        if (count == 0 && !met)
            break;
        for (int i = 0; i < count; i += LANES)
            look_into(walkers, rays + i, MIN(count - i, LANES), coefficients, extent, frame, &roots, tile->states LOOKING_ALONG);
#if LAYERED
        if (roots.count)
            refine_roots(&roots, walkers, tile->states);
#endif
        looked = 1;
    }
    if (roots.count)
        refine_roots(&roots, walkers, tile->states);
    for (int g = 0; g < PACKETS; ++g)
        if (any_lane(wanted[g])) {
#if CAST && LAYERED
            // rays that stop at a root search its cell once more, from its beginning
            walkers[g].side.all = choose((tile->states[g].hit < NOWHERE) & walkers[g].found.all, (real)(0.0f), walkers[g].side.all);
#endif
            tile->states[g].side = choose(wanted[g], walkers[g].side.all, tile->states[g].side);
            tile->going[g] = tile->going[g] & !finished(tile->states + g, frame);
        }
}
