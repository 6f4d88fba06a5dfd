// Kernel: THE ray loop. A work-item marches a tile of TILE_HEIGHT rows of TILE_WIDTH rays, in groups of LANES.
//
// All rays of a tile take sample number n before any takes the next. With PATCHED they then share a plane of the
// lattice, and its blend (patch.cl); rays that run along themselves, and planes whose footprint is too large, are
// sampled one by one.
//
// A mode (modes/*.cl, spliced in place of "mode.cl") supplies
//   state_t                       what it carries along the ray
//   begin(state)                  before the first sample
//   gather(..., t, value, active) one sample for the active lanes; gives the lanes that need no more
//   matters(..., low, high, t, active) whether a value from low to high, at t or past it, could change what any
//                                 active lane shows
//   ANY_ORDER                     whether samples may be gathered in any order: then where PROMISE(low, high) is
//                                 greatest comes first
//   REACH                         how many samples away others may depend on a sample: isosurfaces look at the next
//   finish(...)                   the colour, not premultiplied, and at which t it lies, or NOWHERE
//
// Samples are gathered slab by slab. What lies where no value matters is never looked at (skip.cl); the
// picture is the same to the last bit, since every sample that is gathered is evaluated as it would be without.
//
// Set by the host: SLAB, LANES, TILE_WIDTH, TILE_HEIGHT, PATCHED, ENDPOINTS, SHADED, GRADIENT_CENTRAL, GUIDES,
// TABLE_SIZE, and what is included.

// Where registers hold sixteen numbers, twice as many rays. (Elsewhere PoCL 3.0 aborts on float16 on some processors.)
#if LANES == 8 && TILE_HEIGHT % 2 == 0 && defined(__clang__) && defined(__AVX512F__)
#undef LANES
#define LANES 16
#endif

#include "base/platform.cl"
#include "spline/filter.cl"
#include "spline/boundary.cl"
#include "spline/taps.cl"
#include "spline/pairs.cl"
#include "spline/cell.cl"
#include "base/math.cl"
#include "base/vector.cl"
#include "base/transpose.cl"
#include "frame.cl"
#include "march/camera.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"
#include "march/segments.cl"

#if PATCHED
#define RARE OUT_OF_LINE
#include "march/plane.cl"
#else
#define RARE INLINE
typedef struct { int made, usable; } patch_t, here_t;
#endif

// -- the function along a ray: what modes may ask for ---------------------------------------------------

#define SCENE_PARAMS COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table, const ray_t *ray, patch_t *patch, here_t *here
#define SCENE coefficients, extent, frame, table, ray, patch, here

INLINE int within(int i, int most) { return i < GRID_SCALE ? GRID_SCALE : i > most ? most : i; }

// The cell of a position on a ray. However a ray was rounded, no tap of it, nor of the cells a sample away, lies
// past what is stored.
INLINE cell_t locate_stored(COEFFICIENTS coefficients, const int4 extent, float x, float y, float z)
{
    const int reach = TAPS + GRID_SCALE + PAIRED_VALUE;
    cell_t c = locate(x, y, z, extent.w);
    c.x = within(c.x, extent.x - (WEIGHTS > reach ? WEIGHTS : reach));
    c.y = within(c.y, extent.y - reach);
    c.z = within(c.z, extent.z - reach);
    return c;
}

RARE float value_one(COEFFICIENTS coefficients, const int4 extent, float x, float y, float z)
{
    return sample_value(coefficients, extent, locate_stored(coefficients, extent, x, y, z));
}

// The value some samples away: the same fraction of another cell. (Adding to the position would round, and
// where the function jumps the neighbour would at times be the wrong one.)
RARE float value_beside(COEFFICIENTS coefficients, const int4 extent, cell_t c, int x, int y, int z)
{
    c.x += x * GRID_SCALE; c.y += y * GRID_SCALE; c.z += z * GRID_SCALE;
    return sample_value(coefficients, extent, c);
}

// Per sample, not per stored coefficient.
RARE gradient_t gradient_one(COEFFICIENTS coefficients, const int4 extent, float x, float y, float z)
{
    gradient_t g;
    const cell_t c = locate_stored(coefficients, extent, x, y, z);
#if GRADIENT_CENTRAL
    g.x = 0.5f * (value_beside(coefficients, extent, c, 1, 0, 0) - value_beside(coefficients, extent, c, -1, 0, 0));
    g.y = 0.5f * (value_beside(coefficients, extent, c, 0, 1, 0) - value_beside(coefficients, extent, c, 0, -1, 0));
    g.z = 0.5f * (value_beside(coefficients, extent, c, 0, 0, 1) - value_beside(coefficients, extent, c, 0, 0, -1));
#else
    float value;
    g = sample_gradient(coefficients, extent, c, &value);
    g.x *= GRID_SCALE; g.y *= GRID_SCALE; g.z *= GRID_SCALE;
#endif
    return g;
}

// Lane by lane: the lanes that are not active ask for nothing.
INLINE real value_at(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u value = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            value.each[i] = value_one(coefficients, extent, x.each[i], y.each[i], z.each[i]);
    return value.all;
}

// The gradient in world directions, in units of the least that is no rounding: its square stays in float's range.
INLINE real3 gradient_at(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u gx = { (real)(0.0f) }, gy = gx, gz = gx;
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i]) {
            const gradient_t g = gradient_one(coefficients, extent, x.each[i], y.each[i], z.each[i]);
            gx.each[i] = g.x; gy.each[i] = g.y; gz.each[i] = g.z;
        }
    return transpose3(frame->gradient, real3_of(gx.all, gy.all, gz.all));
}

// The same two at the sample that is being gathered, which lies on the patch's plane if that is usable.
#if PATCHED

INLINE real value_here(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    const int axis = frame->axis;
    here->cell = patch_locate(patch, axis == 0 ? p.y : p.x, axis == 2 ? p.y : p.z);
    lane_weights(here->cell.tu, here->wu);
    lane_weights(here->cell.tv, here->wv);
    patch_gather(patch->values, &here->cell, here->wv, here->columns);
    return lane_dot(here->columns, here->wu);
}

INLINE real3 gradient_here(SCENE_PARAMS, real t, mask active)
{
    if (GRADIENT_CENTRAL || !patch->usable)
        return gradient_at(SCENE, t, active);
    if (!patch->sloped) {
        patch_blend(patch, coefficients, 1, patch->slopes);
        patch->sloped = 1;
    }
    real slopes[TAPS], columns[TAPS];
    lane_slopes(here->cell.tu, slopes);
    const real du = GRID_SCALE * lane_dot(here->columns, slopes);
    lane_slopes(here->cell.tv, slopes);
    patch_gather(patch->values, &here->cell, slopes, columns);
    const real dv = GRID_SCALE * lane_dot(columns, here->wu);
    patch_gather(patch->slopes, &here->cell, here->wv, columns);
    const real da = GRID_SCALE * lane_dot(columns, here->wu);
    const int axis = frame->axis;
    return transpose3(frame->gradient, axis == 0 ? real3_of(da, du, dv) : axis == 1 ? real3_of(du, da, dv) : real3_of(du, dv, da));
}

#else
#define value_here value_at
#define gradient_here gradient_at
#endif

#include "mode.cl"

// -- the loop ------------------------------------------------------------------------------------------------

// The lanes of the group at pixel (x, y) that lie in the picture.
#define EACH_PIXEL(x, y)             \
    for (int i = 0; i < LANES; ++i)  \
        if ((x) + i % LANES_ACROSS < frame->width && (y) + i / LANES_ACROSS < frame->height)

INLINE void store_lane(constant frame_t *frame, const int x, const int y, float4 color, float t, float3 normal, float3 place,
                       global float4 *rgba, global float *depth, global float *normals, global float *positions)
{
    const size_t pixel = (size_t)y * frame->width + x;
    color.xyz *= color.w;
    color = frame->pass ? rgba[pixel] + color * frame->weight : color * frame->weight;
    if (frame->pass == frame->last_pass) {
        const float3 below = (float3)(frame->background[0], frame->background[1], frame->background[2]);
        color.xyz = frame->opaque ? color.xyz + (1.0f - color.w) * below : color.w > 0.0f ? color.xyz / color.w : (float3)(0.0f);
        color.w = frame->opaque ? 1.0f : color.w;
        color = color > 0.0f ? color < 1.0f ? color : (float4)(1.0f) : (float4)(0.0f);
    }
    rgba[pixel] = color;
#if GUIDES
    if (frame->pass == 0) {
        depth[pixel] = t * frame->unit;
        vstore3(normal, pixel, normals);
        vstore3(place, pixel, positions);
    }
#endif
}

#if PATCHED
INLINE float greatest_of(float4 v)
{
    const float2 two = v.lo > v.hi ? v.lo : v.hi;
    return two.x > two.y ? two.x : two.y;
}

// Moves the patch to plane number n in the rays' way, under the tile's corners: all other rays cross between them.
RARE void tile_patch(COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, patch_t *patch, int left, int top, float way, float n)
{
    const float across = way > 0.0f ? madd(n, frame->spacing, frame->plane) : madd(n, -frame->spacing, frame->plane_back);
    const int axis = frame->axis, u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
    patch->made = 1;
    const int right = MIN(left + TILE_WIDTH, frame->width) - 1, bottom = MIN(top + TILE_HEIGHT, frame->height) - 1;
    const float4 px = (float4)(left, right, left, right) + frame->offset[0], py = (float4)(top, top, bottom, bottom) + frame->offset[1];
#define PIXEL(field, i) madd(px, frame->field##_u[i], madd(py, frame->field##_v[i], frame->field[i]))
    const float4 along = PIXEL(direction, axis);
    const int4 away = along * way <= 0.0f;
    if (away.x | away.y | away.z | away.w)   // a corner whose ray, past the volume, never meets the plane
        return;
    const float4 t = (across - PIXEL(origin, axis)) / along;
    const float4 pu = madd(t, PIXEL(direction, u), PIXEL(origin, u)), pv = madd(t, PIXEL(direction, v), PIXEL(origin, v));
#undef PIXEL
    patch_move(patch, coefficients, extent, axis, way, across, -greatest_of(-pu), greatest_of(pu), -greatest_of(-pv), greatest_of(pv));
}
#endif

// The end of LANES rays: their pixels from x on.
INLINE void finish_rays(SCENE_PARAMS, const state_t *state, const int x, const int y, global float4 *rgba, global float *depth,
                        global float *normals, global float *positions)
{
    real t;
    const color_t color = finish(state, SCENE, &t);

    real3 normal = real3_of((real)(NAN), (real)(NAN), (real)(NAN)), place = normal;
#if GUIDES
    const mask somewhere = t < NOWHERE;
    if (any_lane(somewhere)) {
        const real3 g = gradient_at(SCENE, choose(somewhere, t, ray->enter), somewhere);
        const real squared = dot3(g, g);
        const real unit = choose(dot3(g, ray->world) > 0.0f, (real)(-1.0f), (real)(1.0f)) / square_root(squared);
        const mask known = somewhere & (squared > 1.0f);
        const real3 p = add3(scale3(matrix3(frame->index_to_world, at3(ray->origin, ray->direction, choose(somewhere, t, ray->enter))), (real)(frame->unit)),
                             real3_of((real)(frame->world_origin[0]), (real)(frame->world_origin[1]), (real)(frame->world_origin[2])));
        normal = real3_of(choose(known, g.x * unit, normal.x), choose(known, g.y * unit, normal.y), choose(known, g.z * unit, normal.z));
        place = real3_of(choose(somewhere, p.x, place.x), choose(somewhere, p.y, place.y), choose(somewhere, p.z, place.z));
    }
#endif
    const lanes_u red = { color.red }, green = { color.green }, blue = { color.blue }, opacity = { color.opacity }, depths = { t + ray->ahead };
    const lanes_u nx = { normal.x }, ny = { normal.y }, nz = { normal.z }, x_ = { place.x }, y_ = { place.y }, z_ = { place.z };
    EACH_PIXEL(x, y)
        store_lane(frame, x + i % LANES_ACROSS, y + i / LANES_ACROSS, (float4)(red.each[i], green.each[i], blue.each[i], opacity.each[i]), depths.each[i],
                   (float3)(nx.each[i], ny.each[i], nz.each[i]), (float3)(x_.each[i], y_.each[i], z_.each[i]),
                   rgba, depth, normals, positions);
}

#define GROUPS_ACROSS (TILE_WIDTH / LANES_ACROSS)
#define GROUPS (TILE_WIDTH * TILE_HEIGHT / LANES)
#define MARGIN ((real)(ENDPOINTS ? 1.0f : 0.0f))   // sample numbers before and after the lattice, for the two ends
#define COARSEST 4                                 // 1 << 4 slabs are skipped at once at most
#define PARTS 32                                   // of a ray, at most, where the order is free

// The lanes that have samples among the numbers from first to last.
INLINE mask lanes_within(const ray_t *ray, mask going, float first, float last)
{
    return going & (ray->begin - MARGIN <= last) & (ray->end + MARGIN >= first);
}

// The least and greatest value among samples first to last of some groups of rays.
INLINE float2 values_of(global const float2 *bounds, const int4 extent, constant frame_t *frame, const ray_t *rays,
                        const mask *going, const int groups, float first, float last)
{
    boxes_t box;
    box_nothing(&box);
    for (int g = 0; g < groups; ++g)
        box_samples(rays + g, first - REACH, last + REACH, lanes_within(rays + g, going[g], first, last), &box);
    return values_within(bounds, extent, frame, &box);
}

kernel void march(COEFFICIENTS coefficients, const int4 extent, global const float2 *bounds, constant frame_t *frame, global const float4 *table,
                  global float4 *rgba, global float *depth, global float *normals, global float *positions, global float *visited)
{
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;
    if (left >= frame->width || top >= frame->height)
        return;
    ray_t rays[GROUPS];
    state_t states[GROUPS];
    mask going[GROUPS];
    real gathered[GROUPS];   // samples
    float first = INFINITY, last = -INFINITY;
    mask forward = ~NONE, backward = ~NONE;
    for (int g = 0; g < GROUPS; ++g) {
        const real x = left + g % GROUPS_ACROSS * LANES_ACROSS + LANE_X, y = top + g / GROUPS_ACROSS * LANES_DOWN + LANE_Y;
        rays[g] = pixel_ray(frame, x + frame->offset[0], y + frame->offset[1]);
        begin(&states[g]);
        gathered[g] = (real)(0.0f);
        going[g] = rays[g].hits & (x < (real)(frame->width)) & (y < (real)(frame->height));
        const float low = min_lane(choose(going[g], rays[g].begin - MARGIN, NOWHERE)), high = max_lane(choose(going[g], rays[g].end + MARGIN, -NOWHERE));
        first = low < first ? low : first;
        last = high > last ? high : last;
#if PATCHED
        const real along = axis_of(rays[g].direction, frame->axis);
        forward &= (rays[g].planar & (along > 0.0f)) | !going[g];
        backward &= (rays[g].planar & (along < 0.0f)) | !going[g];
#endif
    }
    patch_t patches[SLAB];   // one for each plane of a slab, made when the first group of rays asks for it
#if PATCHED
    // whether all rays of the tile cross the planes, and in one direction
    const int planar = !any_lane(!forward) || !any_lane(!backward);
    const float way = any_lane(!forward) ? -1.0f : 1.0f;
#endif
    const int slabs = last >= first ? (int)((last - first) / frame->slab) + 1 : 0;
    int deep = 30, parts = 1;   // parts of 1 << deep slabs
#if ANY_ORDER
    float promise[PARTS];       // of each part, at most
    promise[0] = 0.0f;
    if (frame->skipping) {
        for (deep = 0; slabs >> deep >= PARTS; ++deep)
            ;
        for (parts = 0; parts << deep < slabs; ++parts) {
            const float start = madd(parts << deep, frame->slab, first), stop = madd(1 << deep, frame->slab, start - 1.0f);
            const float2 values = values_of(bounds, extent, frame, rays, going, GROUPS, start, stop);
            promise[parts] = PROMISE(values.x, values.y);
        }
    }
#endif
    for (int turn = 0; turn < parts; ++turn) {
        int part = 0;
#if ANY_ORDER
        for (int i = 1; i < parts; ++i)
            part = promise[i] > promise[part] ? i : part;
        if (promise[part] == -INFINITY)
            break;                       // no ray has samples in those that are left
        promise[part] = -INFINITY;       // its turn comes once
#endif
        const int until = part + 1 < parts ? (part + 1) << deep : slabs;
        for (int slab = part << deep, level = deep < COARSEST ? deep : COARSEST; slab < until;) {
            const float start = madd(slab, frame->slab, first), ahead = madd(1 << level, frame->slab, start - 1.0f);
            const float stop = ahead < last ? ahead : last;
            int some = 0, wanted = !frame->skipping;
            for (int g = 0; g < GROUPS; ++g)
                some |= any_lane(going[g] & (rays[g].end + MARGIN >= start));
            if (!some)
                break;
            if (frame->skipping) {
                const float2 values = values_of(bounds, extent, frame, rays, going, GROUPS, start, stop);
                for (int g = 0; g < GROUPS && !wanted; ++g)
                    wanted = matters(&states[g], frame, table, values.x, values.y, madd(start, rays[g].step, rays[g].first),
                                     lanes_within(rays + g, going[g], start, stop));
            }
            if (!wanted) {
                slab += 1 << level;
                while (level < COARSEST && level < deep && (slab & (1 << level)) == 0)
                    ++level;
                continue;
            }
            if (level > 0) {
                --level;
                continue;
            }
            for (int i = 0; i < SLAB; ++i)
                patches[i].made = patches[i].usable = 0;
            for (int g = 0; g < GROUPS; ++g) {
                const ray_t *ray = rays + g;
                mask run = lanes_within(ray, going[g], start, stop);
                if (!any_lane(run))
                    continue;
                if (GROUPS > 1 && frame->skipping) {
                    const float2 values = values_of(bounds, extent, frame, ray, going + g, 1, start, stop);
                    if (!matters(&states[g], frame, table, values.x, values.y, madd(start, ray->step, ray->first), run))
                        continue;
                }
                state_t state = states[g];
                real count = gathered[g];
                run = going[g];
                float n = start;
                for (patch_t *patch = patches; patch < patches + SLAB && n <= stop; ++patch, n += 1.0f) {
                    const mask active = lanes_within(ray, run, n, n);
                    if (!any_lane(active))
                        continue;
                    real t = madd(n, ray->step, ray->first);   // by multiplication: never accumulated
#if ENDPOINTS
                    // a little inside: on the face itself rounding would decide whether it is read from past the edge
                    const real inset = 1e-3f * ray->step;
                    t = MIN(MAX(t, ray->enter + inset), ray->leave - inset);
#endif
                    here_t sample_here, *here = &sample_here;
                    real value;
#if PATCHED
                    // before and after the lattice, where rays have their ends alone, a plane may lie past what is stored
                    if (planar && !patch->made && n >= 0.0f && n < frame->planes)
                        tile_patch(coefficients, extent, frame, patch, left, top, way, n);
                    if (patch->usable) {
                        value = value_here(SCENE, t, active);
#if ENDPOINTS
                        const mask ends = active & ((ray->begin > n) | (ray->end < n));
                        if (any_lane(ends))
                            value = choose(ends, value_at(SCENE, t, ends), value);
#endif
                    } else
#endif
                        value = value_at(SCENE, t, active);
                    run = run & !gather(&state, SCENE, t, value, active);
                    count += choose(active, (real)(1.0f), (real)(0.0f));
                }
                states[g] = state;
                gathered[g] = count;
                going[g] = run;
            }
            ++slab;
        }
    }
    for (int g = 0; g < GROUPS; ++g) {
        const int x = left + g % GROUPS_ACROSS * LANES_ACROSS, y = top + g / GROUPS_ACROSS * LANES_DOWN;
        const ray_t *ray = rays + g;
        here_t *here = 0;   // no sample is being gathered
        patch_t *patch = patches;
        if (x < frame->width && y < frame->height) {
            finish_rays(SCENE, &states[g], x, y, rgba, depth, normals, positions);
#if GUIDES
            const real samples = ray->end - ray->begin + 1.0f + 2.0f * MARGIN;
            const lanes_u share = { choose(ray->hits & (samples > 0.0f), gathered[g] / samples, (real)(NAN)) };
            if (frame->pass == 0)
                EACH_PIXEL(x, y)
                    visited[(size_t)(y + i / LANES_ACROSS) * frame->width + x + i % LANES_ACROSS] = share.each[i];
#endif
        }
    }
}
