// The ray through a pixel, its intersection with the volume, and its samples.

#include "base/math.cl"
#include "base/vector.cl"
#include "frame.cl"

// The rays of a packet are side by side, sixteen in two rows of eight.
#if LANES == 1
#define LANES_ACROSS 1
#define LANE_X 0.0f
#define LANE_Y 0.0f
#elif LANES == 8
#define LANES_ACROSS 8
#define LANE_X (real)(0, 1, 2, 3, 4, 5, 6, 7)
#define LANE_Y (real)(0.0f)
#else
#define LANES_ACROSS 8
#define LANE_X (real)(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)
#define LANE_Y (real)(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1)
#endif
#define LANES_DOWN (LANES / LANES_ACROSS)

// Positions in samples; t along the ray in mean spacings, from the plane through the volume's centre that faces the
// camera: near the samples float32 has its best precision. `world` is the unit direction in the world.
typedef struct {
    real3 origin, direction, world;
    real ahead;             // t of that plane, counted from the camera
    real enter, leave;      // t where the ray is inside the domain and what cuts keep
    real first, step;       // sample n lies at t = first + n * step
    real begin, end;        // the samples are those with begin <= n <= end
    mask cut, more;         // whether it enters at the face of a cut; whether further parts may follow (placed_ray)
    mask hits, planar;      // whether it meets the volume; whether its samples lie on the planes ...
    mask alone;             // ... but for a ray that leaves before the next plane: it has one sample, in its middle
} ray_t;

INLINE void clip_axis(real origin, real direction, float low, float high, real *enter, real *leave)
{
    const real d = choose(magnitude(direction) < 1e-12f, (real)(1e-12f), direction);
    const real a = (low - origin) / d, b = (high - origin) / d;
    // a ray along the faces is inside, even on a face, or outside all the way
    const mask inside = (magnitude(direction) < 1e-12f) & (low <= origin) & (origin <= high);
    *enter = MAX(*enter, choose(inside, -NOWHERE, MIN(a, b)));
    *leave = MIN(*leave, choose(inside, NOWHERE, MAX(a, b)));
}

// Keeps the side of a plane (normal, offset) that its normal points away from.
INLINE void clip_plane(real3 origin, real3 direction, constant float *plane, real *enter, real *leave)
{
    const real3 normal = real3_of((real)(plane[0]), (real)(plane[1]), (real)(plane[2]));
    const real beyond = dot3(origin, normal) - plane[3], slope = dot3(direction, normal);
    const mask along = magnitude(slope) < 1e-12f;
    const real t = -beyond / choose(along, (real)(1.0f), slope);
    const mask gone = along & (beyond > 0.0f);
    *enter = MAX(*enter, choose(gone, NOWHERE, choose(!along & (slope < 0.0f), t, -NOWHERE)));
    *leave = MIN(*leave, choose(gone, -NOWHERE, choose(!along & (slope > 0.0f), t, NOWHERE)));
}

#define MAX_CORNERS 8

// Part number `part`, counted from 0, of what the corners leave of rays from `enter` to `leave`; neither the parts nor the holes between
// them are shorter than `least`. Where there are fewer parts, `enter` is past `leave`.
INLINE void keep_part(constant clip_block *clip, real3 origin, real3 direction, const int part, const real least, real *enter, real *leave)
{
    real from[MAX_CORNERS], past[MAX_CORNERS], at = *enter, end = *leave;
    for (int i = 0; i < clip->corners; ++i) {
        constant float *low = clip->corner + 6 * i, *high = low + 3;
        from[i] = *enter;
        past[i] = *leave;
        clip_axis(origin.x, direction.x, low[0], high[0], from + i, past + i);
        clip_axis(origin.y, direction.y, low[1], high[1], from + i, past + i);
        clip_axis(origin.z, direction.z, low[2], high[2], from + i, past + i);
        from[i] = choose(past[i] > from[i] + least, from[i], NOWHERE);
    }
    for (int k = 0; k <= part; ++k) {
        at = k ? end : at;
        for (int pass = 0; pass < clip->corners; ++pass)   // corners may overlap, in any order
            for (int i = 0; i < clip->corners; ++i)
                at = choose((from[i] <= at + least) & (at < past[i]), past[i], at);
        end = *leave;
        for (int i = 0; i < clip->corners; ++i)
            end = choose(from[i] > at, MIN(end, from[i]), end);
    }
    const mask none = (*enter > *leave) | ((at > *leave - least) & ((at > *enter) | (mask)(part ? ~0 : 0)));
    *enter = choose(none, (real)(1.0f), at);
    *leave = choose(none, (real)(0.0f), end);
}

INLINE real axis_of(real3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

// Component i of a ray's origin or direction at pixel (px, py): a linear function of both. (For numbers and for vectors.)
#define AT_PIXEL(field, i) madd(px, camera->field##_u[i], madd(py, camera->field##_v[i], camera->field[i]))

// What of a ray is in the domain, and its samples: of what corners leave of it, the part of this number, or with -1 all, as if there
// were none. Set are its origin and directions, and in `enter` where it begins. Its samples lie on the planes that the line from
// `from` along `rail` crosses, unless it has steps of its `own`.
INLINE ray_t placed_ray(ray_t ray, constant frame_t *frame, const real3 from, const real3 rail, const mask own, const int part)
{
    constant geometry_block *geometry = &frame->geometry;
    constant planes_block *planes = &frame->planes;
    const real length = square_root(dot3(ray.direction, ray.direction)), begin = ray.enter;
    ray.leave = NOWHERE;
    clip_axis(ray.origin.x, ray.direction.x, geometry->low[0], geometry->high[0], &ray.enter, &ray.leave);
    clip_axis(ray.origin.y, ray.direction.y, geometry->low[1], geometry->high[1], &ray.enter, &ray.leave);
    clip_axis(ray.origin.z, ray.direction.z, geometry->low[2], geometry->high[2], &ray.enter, &ray.leave);
    const real uncut = ray.enter, end = ray.leave;
    real whole = uncut;   // without corners
    ray.cut = ray.more = NONE;
    if (frame->clip.clipped) {
        const real3 place = matrix3(geometry->index_to_world, ray.origin);
        const real least = planes->margin / length;   // less may be rounding
        clip_axis(place.x, ray.world.x, frame->clip.low[0], frame->clip.high[0], &ray.enter, &ray.leave);
        clip_axis(place.y, ray.world.y, frame->clip.low[1], frame->clip.high[1], &ray.enter, &ray.leave);
        clip_axis(place.z, ray.world.z, frame->clip.low[2], frame->clip.high[2], &ray.enter, &ray.leave);
        for (int i = 0; i < frame->clip.planes; ++i)
            clip_plane(place, ray.world, frame->clip.plane + 4 * i, &ray.enter, &ray.leave);
        ray.enter = choose(ray.enter <= uncut + least, uncut, ray.enter);
        ray.leave = choose(ray.leave >= end - least, end, ray.leave);
        whole = ray.enter;
        if (part >= 0 && frame->clip.corners) {
            const real last = ray.leave;
            keep_part(&frame->clip, place, ray.world, part, least, &ray.enter, &ray.leave);
            ray.more = (ray.enter <= ray.leave) & (ray.leave < last);
        }
        ray.cut = ray.enter > uncut;
    }
    ray.hits = ray.enter <= ray.leave;

    // Samples lie where the ray crosses equally spaced planes perpendicular to one axis of the volume ...
    real start = SEVERAL ? begin : whole, span = length;
#if SEVERAL
    // ... of one of several media; all others take theirs at the same t
    span = square_root(dot3(rail, rail));
    real past = NOWHERE;
    clip_axis(from.x, rail.x, frame->rails.low[0], frame->rails.high[0], &start, &past);
    clip_axis(from.y, rail.y, frame->rails.low[1], frame->rails.high[1], &start, &past);
    clip_axis(from.z, rail.z, frame->rails.low[2], frame->rails.high[2], &start, &past);
#endif
    const real along_axis = axis_of(rail, planes->axis);
    const mask oblique = own | (magnitude(along_axis) < planes->oblique * span);
    ray.planar = !oblique;
    const real d = choose(oblique, (real)(1.0f), along_axis);
    const real plane = choose(d > 0.0f, (real)(planes->first), (real)(planes->last));
    // ... or, on rays too oblique to these planes, at equal steps along the ray from where it enters
    const real stride = planes->stride / span;
    ray.step = choose(oblique, stride, planes->spacing / magnitude(d));
    ray.first = choose(oblique, start + 0.5f * stride, (plane - axis_of(from, planes->axis)) / d);
    ray.begin = MAX((real)(0.0f), -round_down((ray.first - ray.enter) / ray.step));
    ray.begin = choose(oblique & (ray.enter == whole) & (mask)(SEVERAL ? 0 : ~0), (real)(0.0f), ray.begin);
    ray.end = round_down((ray.leave - ray.first) / ray.step);
    ray.end = choose(oblique, ray.end, MIN(ray.end, (real)(planes->count - 1.0f)));

    ray.alone = ray.hits & (ray.end < ray.begin) & (mask)(ENDPOINTS ? 0 : ~0);
    ray.first = choose(ray.alone, 0.5f * (ray.enter + ray.leave), ray.first);
    ray.step = choose(ray.alone, (real)(0.0f), ray.step);
    ray.begin = choose(ray.alone, MIN(ray.begin, (real)(planes->count - 1.0f)), ray.begin);
    ray.end = choose(ray.alone, ray.begin, ray.end);
    return ray;
}

// The ray through a pixel, or a part of it.
INLINE ray_t pixel_ray(constant frame_t *frame, real px, real py, const int part)
{
    constant camera_block *camera = &frame->camera;
    ray_t ray;
    ray.origin = real3_of(AT_PIXEL(origin, 0), AT_PIXEL(origin, 1), AT_PIXEL(origin, 2));
    const real3 along = real3_of(AT_PIXEL(direction, 0), AT_PIXEL(direction, 1), AT_PIXEL(direction, 2));
    const real3 world = matrix3(frame->geometry.index_to_world, along);
    const real stretch = square_root(dot3(world, world)), per_unit = 1.0f / stretch;
    ray.direction = scale3(along, per_unit);
    ray.world = scale3(world, per_unit);
    ray.ahead = camera->ahead * stretch;
    ray.enter = camera->orthographic ? -NOWHERE : -ray.ahead;   // nothing is visible behind a perspective camera
#if SEVERAL
    {
        constant rails_block *camera = &frame->rails;
        const real3 from = real3_of(AT_PIXEL(origin, 0), AT_PIXEL(origin, 1), AT_PIXEL(origin, 2));
        const real3 rail = scale3(real3_of(AT_PIXEL(direction, 0), AT_PIXEL(direction, 1), AT_PIXEL(direction, 2)), per_unit);
        return placed_ray(ray, frame, from, rail, NONE, part);
    }
#else
    return placed_ray(ray, frame, ray.origin, ray.direction, NONE, part);
#endif
}

// Where rays are at t, counted from the volume's centre, in mean spacings of the world.
INLINE real3 from_center(constant frame_t *frame, const ray_t *ray, const real t)
{
    constant float *center = frame->geometry.center;
    const real3 origin = real3_of(ray->origin.x - center[0], ray->origin.y - center[1], ray->origin.z - center[2]);
    return matrix3(frame->geometry.index_to_world, at3(origin, ray->direction, t));
}

// The extent of the stretch of sample number n, at t, before and after it: half a step, except from the ray's entry to the first
// sample, and from the last one to its exit. True if n is the first or the last of some active ray.
INLINE int stretch_of(const ray_t *ray, float n, real t, mask active, real *before, real *behind)
{
    *before = *behind = 0.5f * ray->step;
    const mask first = ray->begin == n, last = ray->end == n;
    if (!any_lane(active & (first | last)))
        return 0;
    *before = choose(first, MAX(t - ray->enter, (real)(0.0f)), *before);
    *behind = choose(last, MAX(ray->leave - t, (real)(0.0f)), *behind);
    return 1;
}

// Where rays cross plane number n on their way up (way > 0) or down the axis.
INLINE float plane_at(constant planes_block *planes, float way, float n)
{
    return way > 0.0f ? madd(n, planes->spacing, planes->first) : madd(n, -planes->spacing, planes->last);
}

// Where the rays through the corners of a tile cross the plane at `across`, along u and v: all other rays of the tile cross it
// in between. False if a ray, past the volume, never does.
INLINE int tile_footprint(constant frame_t *frame, int left, int top, int right, int bottom, float way, float across,
                          float2 *range_u, float2 *range_v)
{
    constant camera_block *camera = &frame->camera;
    const int axis = frame->planes.axis, u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
    const float4 px = (float4)(left, right, left, right) + frame->picture.offset[0];
    const float4 py = (float4)(top, top, bottom, bottom) + frame->picture.offset[1];
    const float4 along = AT_PIXEL(direction, axis);
    const int4 away = along * way <= 0.0f;
    if (away.x | away.y | away.z | away.w)
        return 0;
    const float4 t = (across - AT_PIXEL(origin, axis)) / along;
    const float4 pu = madd(t, AT_PIXEL(direction, u), AT_PIXEL(origin, u)), pv = madd(t, AT_PIXEL(direction, v), AT_PIXEL(origin, v));
    const float4 low = (float4)(MIN(pu.lo, pu.hi), MIN(pv.lo, pv.hi)), high = (float4)(MAX(pu.lo, pu.hi), MAX(pv.lo, pv.hi));
    *range_u = (float2)(MIN(low.x, low.y), MAX(high.x, high.y));
    *range_v = (float2)(MIN(low.z, low.w), MAX(high.z, high.w));
    return 1;
}
