// Regions of labels, with smooth boundaries: every region that a ray enters, in order. A sample's value is the label of its region
// (sample.cl). Between two samples with different ones lies a boundary, which is found by halving; behind it the next is sought.

#include "march/sample.cl"
#include "march/light.cl"
#include "march/enclose.cl"
#include "march/slots.cl"
#include "transfer/ramp.cl"

typedef struct {
    real red, green, blue, light, depth, label, before;   // label: of the sample before, at `before`
    mask started, face;                                    // whether there is one; whether the result is where rays begin
#if ADDED
    slots_t slots;   // where regions are added to the samples of media
#endif
} state_t;

#define REACH 1.0f   // a boundary lies between two samples
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f
#define FAINT 1e-6f          // rays end where less light is left
#define TOLERANCE 1e-4f      // of a boundary, in voxels
#define AT_ENTRY 1e-2f       // samples that are no further from where a ray begins are its ends there

INLINE void begin(state_t *s)
{
    s->red = s->green = s->blue = s->label = s->before = (real)(0.0f);
    s->light = (real)(1.0f);
    s->depth = NOWHERE;
    s->started = s->face = NONE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->light < FAINT; }

#if ADDED
INLINE void set_light(state_t *s, const real opacity, const real rest, const lanes_u carried[CARRIED])
{
    s->light = (1.0f - opacity) - rest;
    s->started = carried[0].all > 0.0f;
    s->label = carried[1].all;
    s->before = carried[2].all;
}

INLINE void light_of(const state_t *s, real *opacity, real *rest, lanes_u carried[CARRIED])
{
    *opacity = (real)(1.0f);
    *rest = -s->light;   // which is exact
    carried[0].all = choose(s->started, (real)(1.0f), (real)(0.0f));
    carried[1].all = s->label;
    carried[2].all = s->before;
}
#endif

// Inside a single region nothing changes; but rays may begin there.
INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !transparent(&frame->transfer, table, low, high) && (low != high || any_lane(active & !s->started));
}

// Rays enter a region at t, where its lead has a gradient, or else on a face. The place of the result is that at which half of the light is stopped.
INLINE void enter_region(state_t *s, const sample_t *sample, const real label, const real t,
                         const real3 *gradient, mask active)
{
    color_t color = classify(&sample->frame->transfer, sample->table, label);
    active &= color.opacity > 0.0f;
    if (!any_lane(active))
        return;
    if (SHADED && gradient)
        color = shade(sample, color, *gradient, label, choose(active, t, sample->ray->enter), active);
#if ADDED
    // faces, like those of matter, in front of all samples; a boundary to the sample behind it
    const real number = gradient ? (real)(sample->number) : sample->ray->begin - 1.0f;
    add_each(&s->slots, number, color, log_light(color, (real)(1.0f)), active);
#endif
    const real share = choose(active, s->light * color.opacity, (real)(0.0f)), left = s->light * color.clear;
    s->red = madd(share, color.red, s->red);
    s->green = madd(share, color.green, s->green);
    s->blue = madd(share, color.blue, s->blue);
    const mask here = active & (s->light > 0.5f) & (left <= 0.5f);
    s->depth = choose(here, t, s->depth);
    s->face = choose_whole(here, (mask)(gradient ? 0 : ~0), s->face);
    s->light = choose(active, left, s->light);
}

INLINE void begin_in(state_t *s, const sample_t *sample, const real label, const real t, const mask active)
{
    const ray_t *ray = sample->ray;
    mask entry = active & (t <= madd((real)(AT_ENTRY), ray->step, ray->enter));
#if ADDED
    entry &= ray->begin > s->slots.from;   // others were added before
#endif
    if (any_lane(entry))
        enter_region(s, sample, label, ray->enter, 0, entry);
    s->label = choose(active, label, s->label);
    s->before = choose(active, t, s->before);
    s->started |= active;
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const ray_t *ray = sample->ray;
    const mask first = active & !s->started;
    if (any_lane(first))
        begin_in(s, sample, value, t, first);
    // behind skipped samples, of which none is seen, the region is another one
    mask crossed = active & (s->label != value) & (t - s->before < 1.5f * ray->step);
    const real close = TOLERANCE / square_root(dot3(ray->direction, ray->direction));
    while (any_lane(crossed)) {
        real far = t, entered = value;
        real3 gradient;
        enclose(coefficients, sample, s->label, s->before, close, &far, &entered, &gradient, crossed);
        enter_region(s, sample, entered, far, &gradient, crossed);
        s->label = choose(crossed, entered, s->label);
        s->before = choose(crossed, far, s->before);
        crossed &= (s->label != value) & !finished(s, sample->frame);
    }
    s->label = choose(active, value, s->label);
    s->before = choose(active, t, s->before);
    return active & finished(s, sample->frame);
}

// The one in front has stopped some of the light of the one behind, which begins with the last sample of that one (REACH).
INLINE void merge(state_t *front, const state_t *back)
{
    front->red = madd(front->light, back->red, front->red);
    front->green = madd(front->light, back->green, front->green);
    front->blue = madd(front->light, back->blue, front->blue);
    front->face = choose_whole(front->depth < NOWHERE, front->face, back->face);
    front->depth = choose(front->depth < NOWHERE, front->depth, back->depth);
    front->light *= back->light;
    front->label = choose(back->started, back->label, front->label);
    front->before = choose(back->started, back->before, front->before);
    front->started |= back->started;
}

#define FACES(frame) 1
#define ON_FACE(state) ((state)->face)
#define RESTARTS 1

INLINE void restart(state_t *s, mask active) { s->started &= !active; }

INLINE mask gather_face(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real value, mask active)
{
    begin_in(s, sample, value, sample->ray->enter, active);
    return active & finished(s, sample->frame);
}

INLINE real place_of(const state_t *s) { return s->depth; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    const real opacity = 1.0f - s->light, per = 1.0f / MAX(opacity, (real)(1e-20f));
    const color_t color = { s->red * per, s->green * per, s->blue * per, opacity, s->light };
    return color;
}
