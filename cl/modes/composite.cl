// Emission and absorption, front to back; a sample's opacity is that of the stretch of the ray that it represents.
//
// With BETWEEN, set by the host, samples are dependent: matter is that of virtual samples between two, whose values are Hermite's
// and whose gradients lie on the parabola through those of the last three, but for the part along the ray, which is Hermite's.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"
#include "march/graded.cl"
#include "march/colored.cl"
#include "march/slots.cl"

// Opacity is accumulated with its rounding error (Kahan), so that sums of thousands of thin samples are exact.
typedef struct {
    real red, green, blue, opacity, rest, depth;
#if BETWEEN
    real t, value, shown, x, y, z;           // the sample before, if t is not NOWHERE: whether it is visible, its gradient
    real last_t, last_x, last_y, last_z;     // the one before that
#endif
#if ADDED
    slots_t slots;   // where samples are added to those of other media, which nothing here hides
#endif
} state_t;

#if BETWEEN
#define REACH 2.0f   // so that the three samples are gathered wherever something is visible between the last two
#define RESTARTS 1
#else
#define REACH 0.0f
#endif
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s)
{
    s->red = s->green = s->blue = s->opacity = s->rest = (real)(0.0f);
    s->depth = NOWHERE;
#if BETWEEN
    s->value = s->shown = s->x = s->y = s->z = s->last_x = s->last_y = s->last_z = (real)(0.0f);
    s->t = s->last_t = NOWHERE;
#endif
}

INLINE real transmittance(const state_t *s) { return (1.0f - s->opacity) - s->rest; }

INLINE mask finished(const state_t *s, constant frame_t *frame) { return transmittance(s) <= frame->mode.termination; }

#if ADDED
INLINE void set_light(state_t *s, const real opacity, const real rest, const lanes_u carried[CARRIED])
{
    s->opacity = opacity;
    s->rest = rest;
}

INLINE void light_of(const state_t *s, real *opacity, real *rest, lanes_u carried[CARRIED])
{
    *opacity = s->opacity;
    *rest = s->rest;
}
#endif

INLINE void add_opacity(state_t *s, real share, mask active)
{
    const real more = share + s->rest, opacity = s->opacity + more;
    s->rest = choose(active, more - (opacity - s->opacity), s->rest);
    s->opacity = choose(active, opacity, s->opacity);
}

// A stretch of matter of this colour that begins at `start`; `through` is the base-2 logarithm of its transmittance.
INLINE void absorb(state_t *s, const color_t color, const real through, const real start, const real length, const mask seen)
{
    const real light = transmittance(s);
    const real share = light * one_less_exp_2(through);
    s->red = choose(seen, madd(share, color.red, s->red), s->red);
    s->green = choose(seen, madd(share, color.green, s->green), s->green);
    s->blue = choose(seen, madd(share, color.blue, s->blue), s->blue);
    add_opacity(s, share, seen);
    const mask halved = seen & (transmittance(s) <= 0.5f) & (light > 0.5f);   // half of the light is absorbed
    if (any_lane(halved)) {
        const real past = log_2(2.0f * light) / -through;   // the position in the stretch, if it were homogeneous
        s->depth = choose(halved, madd(MIN(past, (real)(1.0f)), length, start), s->depth);
    }
}

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !transparent(&frame->transfer, table, low, high);
}

#if BETWEEN

INLINE void restart(state_t *s, mask active)
{
    s->t = choose(active, NOWHERE, s->t);
    s->last_t = choose(active, NOWHERE, s->last_t);
}

#include "march/between.cl"

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    constant frame_t *frame = sample->frame;
    const real3 gradient = gradient_here(coefficients, sample, t, active);
    const mask shown = active & (classify(&frame->transfer, sample->table, value).opacity > 0.0f), both = active & (s->t < NOWHERE);
    const float low = min_lane(choose(both, MIN(s->value, value), NOWHERE)), high = max_lane(choose(both, MAX(s->value, value), -NOWHERE));
    if (!transparent(&frame->transfer, sample->table, low, high))
        absorb_between(s, coefficients, sample, t, value, shown, gradient, both);
    s->last_t = choose(active, s->t, s->last_t);
    s->last_x = choose(active, s->x, s->last_x);
    s->last_y = choose(active, s->y, s->last_y);
    s->last_z = choose(active, s->z, s->last_z);
    s->t = choose(active, t, s->t);
    s->value = choose(active, value, s->value);
    s->shown = choose(active, choose(shown, (real)(1.0f), (real)(0.0f)), s->shown);
    s->x = choose(active, gradient.x, s->x);
    s->y = choose(active, gradient.y, s->y);
    s->z = choose(active, gradient.z, s->z);
    return finished(s, frame);
}

#else

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    constant frame_t *frame = sample->frame;
    color_t color = classify(&frame->transfer, sample->table, value);
    mask seen = active & (color.opacity > 0.0f);
    if (!any_lane(seen))
        return NONE;
#if SHADED || GRADED
    const real3 gradient = gradient_here(coefficients, sample, t, seen);
#endif
#if GRADED
    color = graded(coefficients, sample, t, value, gradient, color, seen);
    seen = color.opacity > 0.0f;
    if (!any_lane(seen))
        return NONE;
#endif
    color_by(&color, coefficients, sample, t, seen);
#if SHADED
    color = shade(sample, color, gradient, value, t, seen);
#endif
    real before, behind;
    stretch_of(sample->ray, sample->number, t, seen, &before, &behind);
#if MISSING
    stretch_to_edges(sample->missing, frame, sample->ray, t, seen, &before, &behind);
#endif
    const real length = before + behind;
    const real through = log_light(color, length * frame->transfer.per_unit_distance);
#if ADDED
    add_sample(&s->slots, sample->number, color, through, seen);
#endif
    absorb(s, color, through, t - before, length, seen);
    return finished(s, frame);
}

#endif

#define FACES(frame) ((frame)->mode.cap)
#define ON_FACE(state) ((state)->depth < NOWHERE)
#define FACE 16.0f   // unit distances of matter as opaque as the face of a cut

// The slice on the face of a cut is not lit: there, gradients are those of the noise.
INLINE mask gather_face(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real value, mask active)
{
    color_t color = classify(&sample->frame->transfer, sample->table, value);
    mask seen = active & (color.opacity > 0.0f);
#if GRADED
    const real enter = sample->ray->enter;
    color = graded(coefficients, sample, enter, value, gradient_at(coefficients, sample, enter, seen), color, seen);
    seen = color.opacity > 0.0f;
#endif
    color_by(&color, coefficients, sample, sample->ray->enter, seen);
    const real through = log_light(color, (real)(FACE));
#if ADDED
    add_each(&s->slots, sample->ray->begin - 1.0f, color, through, seen);   // in front of all samples
#endif
    const real light = transmittance(s), share = light * one_less_exp_2(through);
    s->red = choose(seen, madd(share, color.red, s->red), s->red);
    s->green = choose(seen, madd(share, color.green, s->green), s->green);
    s->blue = choose(seen, madd(share, color.blue, s->blue), s->blue);
    add_opacity(s, share, seen);
    s->depth = choose(seen & (transmittance(s) <= 0.5f) & (light > 0.5f), sample->ray->enter, s->depth);
    return seen & finished(s, sample->frame);
}

// The depth is exact if one stretch alone absorbs half of the light; a stretch does not know the transmittance in front of it.
INLINE void merge(state_t *front, const state_t *back)
{
    const real light = transmittance(front);
    front->red = madd(light, back->red, front->red);
    front->green = madd(light, back->green, front->green);
    front->blue = madd(light, back->blue, front->blue);
    add_opacity(front, light * back->opacity, ~NONE);
    front->depth = choose(front->depth < NOWHERE, front->depth, back->depth);
}

INLINE real place_of(const state_t *s) { return s->depth; }

INLINE color_t mixed_color(const state_t *s)
{
    const real per_opacity = 1.0f / MAX(s->opacity, (real)(1e-20f));
    const color_t color = { s->red * per_opacity, s->green * per_opacity, s->blue * per_opacity, s->opacity, (real)(0.0f) };
    return color;
}

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample) { return mixed_color(s); }
