// Several translucent isosurfaces inside each other: all roots of the function along the ray, in order, for any step.

#include "march/sample.cl"
#include "march/light.cl"
#include "march/cap.cl"
#include "march/colored.cl"
#include "march/slots.cl"

typedef struct {
    real red, green, blue, light, depth, side, hit, which;
#if CAST
    real last;   // crossing that was lit
#endif
#if ADDED
    slots_t slots;   // where surfaces are added to the samples of media
#endif
} state_t;

#define STRETCHES 1
#define LAYERED 1
#define SURFACES(frame) (frame)->mode.count
#define SOUGHT(frame, k) (frame)->mode.isovalues[k]
#include "march/layers.cl"
#define REACH 1.0f   // a stretch extends to where the next begins
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f
#define FAINT 1e-6f   // rays end where less light is left

INLINE void begin(state_t *s)
{
    s->red = s->green = s->blue = s->side = s->which = (real)(0.0f);
    s->light = (real)(1.0f);
    s->depth = s->hit = NOWHERE;
#if CAST
    s->last = -NOWHERE;
#endif
}

// Or at a crossing that awaits light.
INLINE mask finished(const state_t *s, constant frame_t *frame) { return (s->light < FAINT) | (s->hit < NOWHERE); }

#define AWAITS_LIGHT(state) ((state)->hit < NOWHERE)
#define VALUE_THERE(frame, state) sought_of(frame, (state)->which)
#define LIGHT_BEHIND(state) (state)->light
#if CAST
#define SHADES(sample) ((sample)->left != 0)
#define LAST_OF(state) (state)->last
#else
#define SHADES(sample) 1
#endif

#if ADDED
INLINE void set_light(state_t *s, const real opacity, const real rest, const lanes_u carried[CARRIED])
{
    s->light = (1.0f - opacity) - rest;
    s->side = carried[0].all;
}

INLINE void light_of(const state_t *s, real *opacity, real *rest, lanes_u carried[CARRIED])
{
    *opacity = (real)(1.0f);
    *rest = -s->light;   // which is exact
    carried[0].all = s->side;
}
#endif

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return layer_within(frame, low, high);
}

// A surface of this colour at t. The place of the result is that at which half of the light is stopped.
INLINE void pass_surface(state_t *s, const sample_t *sample, const color_t color, const real t, const mask active)
{
#if ADDED
    const ray_t *ray = sample->ray;   // to the sample whose stretch it lies in
    add_each(&s->slots, round_down((t - ray->first) / ray->step + 0.5f), color, log_2(1.0f - color.opacity), active);
#endif
    const real share = choose(active, s->light * color.opacity, (real)(0.0f)), left = s->light * (1.0f - color.opacity);
    s->red = madd(share, color.red, s->red);
    s->green = madd(share, color.green, s->green);
    s->blue = madd(share, color.blue, s->blue);
    s->depth = choose(active & (s->light > 0.5f) & (left <= 0.5f), t, s->depth);
    s->light = choose(active, left, s->light);
}

INLINE void pass_hit(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, const mask active)
{
    constant frame_t *frame = sample->frame;
    real value;
    color_t color = layer_of(frame, s->which, &value);
    if (SHADES(sample)) {
        const real hit = choose(active, s->hit, sample->ray->enter);
        color_by(&color, coefficients, sample, hit, active);
        if (SHADED)
            color = shade(sample, color, gradient_at(coefficients, sample, hit, active), value, hit, active);
        outline(&color, coefficients, sample, hit, active);
    }
    pass_surface(s, sample, color, s->hit, active);
#if CAST
    s->last = choose(active, s->hit, s->last);
#endif
    s->hit = choose(active, NOWHERE, s->hit);
}

// The one in front has stopped some of the light of the one behind.
INLINE void merge(state_t *front, const state_t *back)
{
    front->red = madd(front->light, back->red, front->red);
    front->green = madd(front->light, back->green, front->green);
    front->blue = madd(front->light, back->blue, front->blue);
    front->light *= back->light;
    front->depth = choose(front->depth < NOWHERE, front->depth, back->depth);
    front->side = choose(back->side == 0.0f, front->side, back->side);
}

#define ON_FACE(state) ((state)->depth < NOWHERE)
#define RESTARTS 1

INLINE void restart(state_t *s, mask active) { s->side = choose(active, (real)(0.0f), s->side); }

INLINE mask gather_face(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real value, mask active)
{
    const mask met = meets_cap(sample, value, active);
    color_t color = cap_color(sample, value);
    color.opacity = (real)(1.0f);
    pass_surface(s, sample, color, sample->ray->enter, met);
    return met;
}

INLINE real place_of(const state_t *s) { return s->depth; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    const real opacity = 1.0f - s->light, per = 1.0f / MAX(opacity, (real)(1e-20f));
    const color_t color = { s->red * per, s->green * per, s->blue * per, opacity, (real)(0.0f) };
    return color;
}
