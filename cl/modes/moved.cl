// The line integral along the ray, and how it changes as the volume moves: six numbers in place of the normal and the position.
//
// Under a translation a and a rotation b about the volume's centre, both small, the integral changes by
//   -a · F - b · M,   F = ∫ ∇f ds,   M = ∫ r × ∇f ds = r₀ × F + d × ∫ t ∇f ds   along r = r₀ + t d,
// and by what the faces of the domain, which move too, add to the ray or take away at both of its ends.

#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real sum, x, y, z, tx, ty, tz; } state_t;   // F and ∫ t ∇f, in units of gradients

#include "modes/sums.cl"

INLINE void begin(state_t *s) { s->sum = s->x = s->y = s->z = s->tx = s->ty = s->tz = (real)(0.0f); }

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const real height = height_of(sample->frame, value), length = length_of(sample, t, active);
    const mask rising = active & ((height > 0.0f) | (mask)(sample->frame->mode.clamped ? 0 : ~0));
    s->sum = choose(active, madd(length, height, s->sum), s->sum);
    if (!any_lane(rising))
        return NONE;
    const real3 slope = scale3(gradient_here(coefficients, sample, t, rising), length);
    s->x = choose(rising, s->x + slope.x, s->x);
    s->y = choose(rising, s->y + slope.y, s->y);
    s->z = choose(rising, s->z + slope.z, s->z);
    s->tx = choose(rising, madd(t, slope.x, s->tx), s->tx);
    s->ty = choose(rising, madd(t, slope.y, s->ty), s->ty);
    s->tz = choose(rising, madd(t, slope.z, s->tz), s->tz);
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    front->sum += back->sum;
    front->x += back->x;
    front->y += back->y;
    front->z += back->z;
    front->tx += back->tx;
    front->ty += back->ty;
    front->tz += back->tz;
}

INLINE real3 cross3(real3 a, real3 b)
{
    return real3_of(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// Adds to F and M the face through which the lanes here pass at t: `way` is 1 where they leave, -1 where they enter.
INLINE void add_face(real3 *force, real3 *moment, COEFFICIENTS coefficients, const sample_t *sample, const real t, const float way, const mask here)
{
    constant geometry_block *geometry = &sample->frame->geometry;
    const ray_t *ray = sample->ray;
    real nearest = NOWHERE;
    real3 across = real3_of((real)(0.0f), (real)(0.0f), (real)(0.0f));
    for (int i = 0; i < 3; ++i) {
        const real origin = axis_of(ray->origin, i), along = axis_of(ray->direction, i);
        const real side = choose(way * along > 0.0f, (real)(geometry->high[i]), (real)(geometry->low[i]));
        const real away = magnitude(origin + t * along - side) / MAX(magnitude(along), (real)(1e-12f));   // along the ray
        const mask nearer = away < nearest;
        const real per = 1.0f / choose(nearer, along, (real)(1.0f));
        nearest = choose(nearer, away, nearest);
        constant float *row = geometry->gradient + 3 * i;
        across = real3_of(choose(nearer, per * row[0], across.x), choose(nearer, per * row[1], across.y), choose(nearer, per * row[2], across.z));
    }
    const real at = choose(here, t, ray->enter), height = height_of(sample->frame, value_at(coefficients, sample, at, here));
    const real3 push = scale3(across, choose(here, -way * height, (real)(0.0f)));
    *force = add3(*force, push);
    *moment = add3(*moment, cross3(from_center(sample->frame, ray, at), push));
}

// The derivatives, in units of the data: by a translation times a length, and by a rotation.
INLINE void write_motion(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real3 *by_translation, real3 *by_rotation)
{
    constant frame_t *frame = sample->frame;
    constant float *g = frame->geometry.gradient, *m = frame->geometry.index_to_world;
    const ray_t *ray = sample->ray;
    real3 force = real3_of(s->x, s->y, s->z), moment = cross3(from_center(frame, ray, (real)(0.0f)), force);
    moment = add3(moment, cross3(ray->world, real3_of(s->tx, s->ty, s->tz)));
    const mask some = ray->hits & (ray->enter < ray->leave);
    const mask from_eye = (mask)(frame->camera.orthographic ? 0 : ~0) & (ray->enter == -ray->ahead);
    if (any_lane(some)) {
        add_face(&force, &moment, coefficients, sample, ray->leave, 1.0f, some);
        add_face(&force, &moment, coefficients, sample, ray->enter, -1.0f, some & !from_eye);
    }
    const float per_slope = g[0] * m[0] + g[1] * m[3] + g[2] * m[6];   // how much longer gradients are than slopes by t
    *by_translation = scale3(force, (real)(-frame->mode.scale / per_slope / frame->geometry.unit));
    *by_rotation = scale3(moment, (real)(-frame->mode.scale / per_slope));
}

#define OWN_GUIDES write_motion
