// Kernel: THE ray loop. A work-item marches a tile of TILE_HEIGHT rows of TILE_WIDTH rays, LANES at a time.
//
// All rays of a tile take sample number n before any takes the next. With PATCHED they then share a plane of the
// lattice, and its blend (patch.cl); rays that run along themselves, and planes whose footprint is too large, are
// sampled one by one.
//
// A mode (modes/*.cl, spliced in place of "mode.cl") supplies
//   state_t                       what it carries along the ray
//   begin(state)                  before the first sample
//   gather(..., t, value, active) one sample for the active lanes; gives the lanes that need no more
//   finish(...)                   the colour, not premultiplied, and at which t it lies, or NOWHERE
//
// Set by the host: LANES, TILE_WIDTH, TILE_HEIGHT, PATCHED, ENDPOINTS, SHADED, GRADIENT_CENTRAL, GUIDES,
// TABLE_SIZE, and what is included.

#include "common.cl"
#include "filter.cl"
#include "boundary.cl"
#include "fetch.cl"
#include "sample.cl"
#include "locate.cl"
#include "real.cl"
#include "frame.cl"
#include "camera.cl"
#include "transfer.cl"
#include "shade.cl"

#if PATCHED
#define RARE static __attribute__((noinline))   // rarely called: kept out of the loop
#include "patch.cl"
#else
#define RARE INLINE
typedef struct { int usable; } patch_t;
#endif

// -- the function along a ray: what modes may ask for ---------------------------------------------------

#define SCENE_PARAMS VOLUME_PARAMS, constant frame_t *frame, global const float4 *table, const ray_t *ray, patch_t *patch
#define SCENE VOLUME, frame, table, ray, patch

RARE float value_one(VOLUME_PARAMS, float x, float y, float z)
{
    return sample_value(VOLUME, locate(x, y, z, extent.w));
}

// The value some samples away: the same fraction of another cell. (Adding to the position would round, and
// where the function jumps the neighbour would at times be the wrong one.)
RARE float value_beside(VOLUME_PARAMS, cell_t c, int x, int y, int z)
{
    c.x += x * GRID_SCALE; c.y += y * GRID_SCALE; c.z += z * GRID_SCALE;
    return sample_value(VOLUME, c);
}

// Per sample, not per stored coefficient.
RARE gradient_t gradient_one(VOLUME_PARAMS, float x, float y, float z)
{
    gradient_t g;
    const cell_t c = locate(x, y, z, extent.w);
#if GRADIENT_CENTRAL
    g.x = 0.5f * (value_beside(VOLUME, c, 1, 0, 0) - value_beside(VOLUME, c, -1, 0, 0));
    g.y = 0.5f * (value_beside(VOLUME, c, 0, 1, 0) - value_beside(VOLUME, c, 0, -1, 0));
    g.z = 0.5f * (value_beside(VOLUME, c, 0, 0, 1) - value_beside(VOLUME, c, 0, 0, -1));
#else
    float value;
    g = sample_gradient(VOLUME, c, &value);
    g.x *= GRID_SCALE; g.y *= GRID_SCALE; g.z *= GRID_SCALE;
#endif
    return g;
}

#if LANES == 1
#define EACH_LANE(do_one) do_one(p.x, p.y, p.z, 0)
#else
#define EACH_LANE(do_one)                                                                            \
    float px[LANES], py[LANES], pz[LANES];                                                           \
    PASTE(vstore, LANES)(p.x, 0, px); PASTE(vstore, LANES)(p.y, 0, py); PASTE(vstore, LANES)(p.z, 0, pz); \
    int wanted[LANES];                                                                               \
    PASTE(vstore, LANES)(active, 0, wanted);                                                         \
    for (int i = 0; i < LANES; ++i)                                                                  \
        if (wanted[i])                                                                               \
            do_one(px[i], py[i], pz[i], i)
#endif

INLINE real value_at(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    float value[LANES] = { 0.0f };
#define ONE(px_, py_, pz_, i) value[i] = value_one(VOLUME, px_, py_, pz_)
    EACH_LANE(ONE);
#undef ONE
#if LANES == 1
    return value[0];
#else
    return PASTE(vload, LANES)(0, value);
#endif
}

// The gradient in world directions, in units of the least that is no rounding: its square stays in float's range.
INLINE real3 gradient_at(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    float gx[LANES] = { 0.0f }, gy[LANES] = { 0.0f }, gz[LANES] = { 0.0f };
#define ONE(px_, py_, pz_, i) do { const gradient_t g = gradient_one(VOLUME, px_, py_, pz_); gx[i] = g.x; gy[i] = g.y; gz[i] = g.z; } while (0)
    EACH_LANE(ONE);
#undef ONE
#if LANES == 1
    return transpose3(frame->gradient, real3_of(gx[0], gy[0], gz[0]));
#else
    return transpose3(frame->gradient, real3_of(PASTE(vload, LANES)(0, gx), PASTE(vload, LANES)(0, gy), PASTE(vload, LANES)(0, gz)));
#endif
}

// The same two at the sample that is being gathered, which lies on the patch's plane if that is usable.
#if PATCHED

#define LANES_OF(name, v)  \
    float name[LANES];     \
    *(lanes_t *)name = (v)

typedef real lanes_t __attribute__((aligned(4)));

INLINE real value_here(SCENE_PARAMS, real t, mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    const int axis = frame->axis;
    LANES_OF(u, axis == 0 ? p.y : p.x);
    LANES_OF(v, axis == 2 ? p.y : p.z);
    float value[LANES];
    for (int i = 0; i < LANES; ++i)
        value[i] = patch_value(patch->values, patch_locate(patch, u[i], v[i], extent.w));
    return *(const lanes_t *)value;
}

INLINE real3 gradient_here(SCENE_PARAMS, real t, mask active)
{
    if (GRADIENT_CENTRAL || !patch->usable)
        return gradient_at(SCENE, t, active);
    if (!patch->sloped) {
        patch_blend(patch, coefficients, 1, patch->slopes);
        patch->sloped = 1;
    }
    const real3 p = at3(ray->origin, ray->direction, t);
    const int axis = frame->axis;
    LANES_OF(u, axis == 0 ? p.y : p.x);
    LANES_OF(v, axis == 2 ? p.y : p.z);
    float du[LANES], dv[LANES], across[LANES];
    for (int i = 0; i < LANES; ++i) {
        const patch_cell_t c = patch_locate(patch, u[i], v[i], extent.w);
        patch_slopes(patch->values, c, du + i, dv + i);
        across[i] = patch_value(patch->slopes, c);
    }
    const real gu = GRID_SCALE * *(const lanes_t *)du, gv = GRID_SCALE * *(const lanes_t *)dv, ga = GRID_SCALE * *(const lanes_t *)across;
    return transpose3(frame->gradient, axis == 0 ? real3_of(ga, gu, gv) : axis == 1 ? real3_of(gu, ga, gv) : real3_of(gu, gv, ga));
}

#else
#define value_here value_at
#define gradient_here gradient_at
#endif

#include "mode.cl"

// -- the loop ------------------------------------------------------------------------------------------------

INLINE void store_lane(constant frame_t *frame, const int x, const int y, float4 color, float t, float3 normal, float3 place,
                       global float4 *rgba, global float *depth, global float *normals, global float *positions)
{
    const size_t pixel = (size_t)y * frame->width + x;
    color.xyz *= color.w;
    rgba[pixel] = frame->pass ? rgba[pixel] + color * frame->weight : color * frame->weight;
#if GUIDES
    if (frame->pass == 0) {
        depth[pixel] = t + frame->depth_offset;
        vstore3(normal, pixel, normals);
        vstore3(place, pixel, positions);
    }
#endif
}

#if PATCHED
// Moves the patch to the plane at `across`, under the tile's corners: all its other rays cross between them.
RARE void tile_patch(VOLUME_PARAMS, constant frame_t *frame, patch_t *patch, int left, int top, float across)
{
    const int axis = frame->axis, u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
    float low_u = INFINITY, high_u = -INFINITY, low_v = INFINITY, high_v = -INFINITY;
    for (int i = 0; i < 4; ++i) {
        int x = left + (i & 1 ? TILE_WIDTH - 1 : 0), y = top + (i & 2 ? TILE_HEIGHT - 1 : 0);
        x = x < frame->width ? x : frame->width - 1;
        y = y < frame->height ? y : frame->height - 1;
        const float px = x + frame->offset[0], py = y + frame->offset[1];
#define PIXEL(field, i) madd(px, frame->field##_u[i], madd(py, frame->field##_v[i], frame->field[i]))
        const float t = (across - PIXEL(origin, axis)) / PIXEL(direction, axis);
        const float pu = madd(t, PIXEL(direction, u), PIXEL(origin, u)), pv = madd(t, PIXEL(direction, v), PIXEL(origin, v));
#undef PIXEL
        low_u = pu < low_u ? pu : low_u;
        high_u = pu > high_u ? pu : high_u;
        low_v = pv < low_v ? pv : low_v;
        high_v = pv > high_v ? pv : high_v;
    }
    patch_move(patch, VOLUME, axis, across, low_u, high_u, low_v, high_v);
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
        const real unit = choose(dot3(g, ray->world) > 0.0f, (real)(-1.0f), (real)(1.0f)) / sqrt(squared);
        const mask known = somewhere & (squared > 1.0f);
        const real3 p = add3(matrix3(frame->index_to_world, at3(ray->origin, ray->direction, choose(somewhere, t, ray->enter))),
                             real3_of((real)(frame->world_origin[0]), (real)(frame->world_origin[1]), (real)(frame->world_origin[2])));
        normal = real3_of(choose(known, g.x * unit, normal.x), choose(known, g.y * unit, normal.y), choose(known, g.z * unit, normal.z));
        place = real3_of(choose(somewhere, p.x, place.x), choose(somewhere, p.y, place.y), choose(somewhere, p.z, place.z));
    }
#endif
#if LANES == 1
    store_lane(frame, x, y, (float4)(color.red, color.green, color.blue, color.opacity), t, (float3)(normal.x, normal.y, normal.z),
               (float3)(place.x, place.y, place.z), rgba, depth, normals, positions);
#else
    float lanes[11][LANES];
#define KEEP(i, v) PASTE(vstore, LANES)(v, 0, lanes[i])
    KEEP(0, color.red); KEEP(1, color.green); KEEP(2, color.blue); KEEP(3, color.opacity); KEEP(4, t);
    KEEP(5, normal.x); KEEP(6, normal.y); KEEP(7, normal.z); KEEP(8, place.x); KEEP(9, place.y); KEEP(10, place.z);
    for (int i = 0; i < LANES && x + i < frame->width; ++i)
        store_lane(frame, x + i, y, (float4)(lanes[0][i], lanes[1][i], lanes[2][i], lanes[3][i]), lanes[4][i],
                   (float3)(lanes[5][i], lanes[6][i], lanes[7][i]), (float3)(lanes[8][i], lanes[9][i], lanes[10][i]),
                   rgba, depth, normals, positions);
#endif
}

#define GROUPS_ACROSS (TILE_WIDTH / LANES)
#define GROUPS (GROUPS_ACROSS * TILE_HEIGHT)
#define MARGIN ((real)(ENDPOINTS ? 1.0f : 0.0f))   // sample numbers before and after the lattice, for the two ends

INLINE float least_lane(real v)
{
#if LANES == 1
    return v;
#else
    float least = v.s0;
    float each[LANES];
    PASTE(vstore, LANES)(v, 0, each);
    for (int i = 1; i < LANES; ++i)
        least = each[i] < least ? each[i] : least;
    return least;
#endif
}

kernel void march(VOLUME_PARAMS, constant frame_t *frame, global const float4 *table, global float4 *rgba,
                  global float *depth, global float *normals, global float *positions)
{
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;
    if (left >= frame->width || top >= frame->height)
        return;
    ray_t rays[GROUPS];
    state_t states[GROUPS];
    mask going[GROUPS];
    float first = INFINITY, last = -INFINITY;
    mask forward = ~NONE, backward = ~NONE;
    for (int g = 0; g < GROUPS; ++g) {
#if LANES == 1
        const real px = left + g % GROUPS_ACROSS + frame->offset[0];
#else
        const real px = left + g % GROUPS_ACROSS * LANES + frame->offset[0] + (real)(0, 1, 2, 3, 4, 5, 6, 7);
#endif
        const int y = top + g / GROUPS_ACROSS;
        rays[g] = pixel_ray(frame, px, (real)(y + frame->offset[1]));
        begin(&states[g]);
        going[g] = rays[g].hits & (px < (real)(frame->width)) & (y < frame->height ? ~NONE : NONE);
        const float low = least_lane(choose(going[g], rays[g].begin, NOWHERE)), high = -least_lane(choose(going[g], -rays[g].end, NOWHERE));
        first = low < first ? low : first;
        last = high > last ? high : last;
#if PATCHED
        const real along = axis_of(rays[g].direction, frame->axis);
        forward &= (rays[g].planar & (along > 0.0f)) | !going[g];
        backward &= (rays[g].planar & (along < 0.0f)) | !going[g];
#endif
    }
    patch_t patch_here;
    patch_t *patch = &patch_here;
    patch->usable = 0;
#if PATCHED
    // whether all rays of the tile cross the planes, and in one direction
    const int planar = !any_lane(!forward) || !any_lane(!backward);
    const float way = any_lane(!forward) ? -1.0f : 1.0f;
    patch_begin(patch, extent, frame->axis);
#endif
    for (float n = first - (ENDPOINTS ? 1.0f : 0.0f); n <= last + (ENDPOINTS ? 1.0f : 0.0f); n += 1.0f) {
        int some = 0, moved = 0;
        for (int g = 0; g < GROUPS; ++g) {
            some |= any_lane(going[g] & (rays[g].end + MARGIN >= n));
            const mask active = going[g] & (rays[g].begin - MARGIN <= n) & (rays[g].end + MARGIN >= n);
            if (!any_lane(active))
                continue;
            const ray_t *ray = rays + g;
            real t = madd(n, ray->step, ray->first);   // by multiplication: never accumulated
#if ENDPOINTS
            t = fmin(fmax(t, ray->enter), ray->leave);
#endif
            real value;
#if PATCHED
            if (planar && !moved) {
                tile_patch(VOLUME, frame, patch, left, top, way > 0.0f ? madd(n, frame->spacing, frame->plane)
                                                                       : madd(n, -frame->spacing, frame->plane_back));
                moved = 1;
            }
            if (patch->usable) {
                const mask ends = active & ((ray->begin > n) | (ray->end < n));
                value = value_here(SCENE, t, active);
                if (any_lane(ends))
                    value = choose(ends, value_at(SCENE, t, ends), value);
            } else
#endif
                value = value_at(SCENE, t, active);
            const mask done = gather(&states[g], SCENE, t, value, active);
            going[g] = going[g] & (!done);
        }
        if (!some)
            break;
    }
    for (int g = 0; g < GROUPS; ++g) {
        const int x = left + g % GROUPS_ACROSS * LANES, y = top + g / GROUPS_ACROSS;
        const ray_t *ray = rays + g;
        if (x < frame->width && y < frame->height)
            finish_rays(SCENE, &states[g], x, y, rgba, depth, normals, positions);
    }
}
