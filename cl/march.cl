// Kernel: THE ray loop. One work-item marches LANES rays, neighbours in a row of pixels.
//
// A mode (modes/*.cl, spliced in place of "mode.cl") supplies
//   state_t                       what it carries along the ray
//   begin(state)                  before the first sample
//   gather(..., t, value, active) one sample for the active lanes; gives the lanes that need no more
//   finish(...)                   the colour, not premultiplied, and at which t it lies, or NOWHERE
//
// Set by the host: LANES, ENDPOINTS, SHADED, GRADIENT_CENTRAL, GUIDES, TABLE_SIZE, and what is included.

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

// -- the function along a ray: what modes may ask for ---------------------------------------------------

#define SCENE_PARAMS VOLUME_PARAMS, constant frame_t *frame, global const float4 *table, const ray_t *ray
#define SCENE VOLUME, frame, table, ray

INLINE float value_one(VOLUME_PARAMS, float x, float y, float z)
{
    return sample_value(VOLUME, locate(x, y, z, extent.w));
}

// The value some samples away: the same fraction of another cell. (Adding to the position would round, and
// where the function jumps the neighbour would at times be the wrong one.)
INLINE float value_beside(VOLUME_PARAMS, cell_t c, int x, int y, int z)
{
    c.x += x * GRID_SCALE; c.y += y * GRID_SCALE; c.z += z * GRID_SCALE;
    return sample_value(VOLUME, c);
}

// Per sample, not per stored coefficient.
INLINE gradient_t gradient_one(VOLUME_PARAMS, float x, float y, float z)
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

kernel void march(VOLUME_PARAMS, constant frame_t *frame, global const float4 *table, global float4 *rgba,
                  global float *depth, global float *normals, global float *positions)
{
    const int x = (int)get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= frame->width || y >= frame->height)
        return;
#if LANES == 1
    const real px = x + frame->offset[0];
#elif LANES == 8
    const real px = x + frame->offset[0] + (real)(0, 1, 2, 3, 4, 5, 6, 7);
#endif
    const ray_t lane_rays = pixel_ray(frame, px, (real)(y + frame->offset[1]));
    const ray_t *ray = &lane_rays;
    state_t state;
    begin(&state);
    mask going = ray->hits;
#if ENDPOINTS
    // a little inside: on the face itself rounding would decide whether it is read from past the edge
    const real inset = 1e-3f * ray->step, enter = ray->enter + inset, leave = ray->leave - inset;
    const real margin = (real)(1.0f);
#else
    const real margin = (real)(0.0f);
#endif
    for (real n = ray->begin - margin; any_lane(going & (n <= ray->end + margin)); n += 1.0f) {
        const mask active = going & (n <= ray->end + margin);
        real t = madd(n, ray->step, ray->first);   // by multiplication: never accumulated
#if ENDPOINTS
        t = fmin(fmax(t, enter), leave);
#endif
        const mask done = gather(&state, SCENE, t, value_at(SCENE, t, active), active);
        going = going & (!done);
    }
    real t;
    const color_t color = finish(&state, SCENE, &t);

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
