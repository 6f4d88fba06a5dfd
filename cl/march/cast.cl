// Rays from the surfaces that a tile's rays meet towards the lights, through the same function by the same search: what surfaces on
// the way leave of each light.
//
// One ray begins a little off the surface, on the side that is seen, further than all roundings reach: those of where the surface was
// met, of where the ray begins and of places on it (`clear`, in samples), and of values, by the slope of the function. There the
// function is on the side of the isovalue that light comes from, so the surface does not hide itself, however flat the light falls;
// whatever lies further away does. The normal is the way on which the least distance is enough. A little of it is back along the
// primary ray, which has met nothing up to there, since a function that jumps has no slope.
//
// A mode whose surfaces are lit like that also supplies
//   AWAITS_LIGHT(state)       the lanes at whose `hit` light is wanted
//   VALUE_THERE(frame, state) the isovalue of that surface
//   LIGHT_BEHIND(state)       what is left of light behind all that a ray met
// and, with LAYERED, a state_t with
//   last                  the last crossing, at which rays go on: each stops at a crossing until that is lit

#if CAST

// What is left of lights where the rays of a tile meet surfaces.
typedef struct cast_s {
    real3 from[PACKETS], normal[PACKETS];   // where rays to lights begin; towards the viewer
    mask wanted[PACKETS], on[PACKETS];      // rays to lights; rays through pixels that have not ended
    real left[PACKETS][MOST_LIGHTS];
} cast_t;

// The rays of a packet to light number `light`, and those that are wanted: others would light nothing.
INLINE ray_t light_ray(constant frame_t *frame, const cast_t *cast, const int light, const int g, const int part, mask *wanted)
{
    constant float *way = frame->cast.ways + 3 * light, *world = frame->lights.each + 7 * light;
    ray_t ray;
    ray.origin = cast->from[g];
    ray.direction = real3_of((real)(way[0]), (real)(way[1]), (real)(way[2]));
    ray.world = real3_of((real)(world[0]), (real)(world[1]), (real)(world[2]));
    ray.ahead = ray.enter = (real)(0.0f);
    ray = placed_ray(ray, frame, ray.origin, ray.direction, ~NONE, part);
    *wanted = cast->wanted[g] & (dot3(cast->normal[g], ray.world) > 0.0f) & ray.hits;
    return ray;
}

// Where rays to lights begin, from where those of a tile await light. Returns whether some do.
INLINE int begin_light_rays(const tile_t *tile, COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table)
{
    cast_t *cast = tile->cast;
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    int some = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const state_t *state = tile->states + g;
        const ray_t *ray = tile->rays + g;
        const mask hit = AWAITS_LIGHT(state);
        cast->wanted[g] = NONE;
        if (!any_lane(hit))
            continue;
        some = 1;
        const sample_t sample = { frame, table, extent, ray, &none, 0, 0.0f, 0 };
        const real t = choose(hit, state->hit, ray->enter);
        const real3 gradient = gradient_at(coefficients, &sample, t, hit);
        real3 normal;
        real facing;
        const mask flat = flat_or_normal(frame, gradient, VALUE_THERE(frame, state), ray->world, &normal, &facing);
        const real per_slope = inverse_root(MIN(MAX(dot3(gradient, gradient), (real)(1e-37f)), (real)(1e37f)));
        const real uncertain = magnitude(VALUE_THERE(frame, state)) * (frame->geometry.rounding * per_slope);
        const real3 across = transpose3(frame->geometry.index_to_world, normal);   // the way of the slope in samples
        const real off = (frame->cast.clear + uncertain) * inverse_root(MAX(dot3(across, across), (real)(1e-20f)));
        const real back = frame->cast.clear * inverse_root(dot3(ray->direction, ray->direction));
        cast->from[g] = at3(at3(ray->origin, ray->direction, t - back), across, off);
        cast->normal[g] = normal;
        cast->wanted[g] = hit & !flat;
    }
    return some;
}

#if LAYERED

// Rays pass through the surfaces that are now lit. Returns whether some go on behind them.
INLINE int pass_lit(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table)
{
    cast_t *cast = tile->cast;
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    float first = INFINITY;
    for (int g = 0; g < PACKETS; ++g) {
        state_t *state = tile->states + g;
        const ray_t *ray = tile->rays + g;
        const mask met = state->hit < NOWHERE;
        tile->going[g] = cast->on[g] = NONE;
        if (!any_lane(met))
            continue;
        sample_t sample = { frame, table, extent, ray, &none, 0, 0.0f, 0 };
        sample.left = cast->left[g];
        pass_hit(state, coefficients, &sample, met);
        const mask on = met & !finished(state, frame);
        tile->going[g] = cast->on[g] = on;
        first = MIN(first, min_lane(choose(on, (state->last - ray->first) / ray->step, NOWHERE)));
    }
    if (!(first < INFINITY))
        return 0;
    // segments stay those of the first march, whose samples are counted
    tile->first = madd(frame->planes.slab, (float)(int)(MAX(first - tile->first, 0.0f) / frame->planes.slab), tile->first);
    return 1;
}

#else
#define pass_lit(tile, coefficients, extent, frame, table) 0
#endif

#endif
