// Regions of labels, with smooth boundaries: every region that a ray enters, in order. A sample's value is the label of its region
// (sample.cl). Between two samples with different ones lies a boundary, which is found by halving; behind it the next is sought.

#include "march/sample.cl"
#include "march/light.cl"
#include "transfer/ramp.cl"

typedef struct {
    real red, green, blue, light, depth, label, before;   // label: of the sample before, at `before`
    mask started, face;                                    // whether there is one; whether the result is where rays begin
} state_t;

#define REACH 1.0f   // a boundary lies between two samples
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f
#define FAINT 1e-6f          // rays end where less light is left
#define TOLERANCE 1e-4f      // of a boundary, in voxels
#define GUESSES 3            // of where it is, before it is enclosed
#define AT_ENTRY 1e-2f       // samples that are no further from where a ray begins are its ends there

INLINE void begin(state_t *s)
{
    s->red = s->green = s->blue = s->label = s->before = (real)(0.0f);
    s->light = (real)(1.0f);
    s->depth = NOWHERE;
    s->started = s->face = NONE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->light < FAINT; }

// Inside a single region nothing changes; but rays may begin there.
INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !transparent(&frame->transfer, table, low, high) && (low != high || any_lane(active & !s->started));
}

// Rays enter a region at t. The place of the result is that at which half of the light is stopped.
INLINE void enter_region(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, const real label, const real t, const int face,
                         mask active)
{
    color_t color = classify(&sample->frame->transfer, sample->table, label);
    active &= color.opacity > 0.0f;
    if (!any_lane(active))
        return;
    if (SHADED && !face) {
        const real3 gradient = gradient_at(coefficients, sample, choose(active, t, sample->ray->enter), active);
        color = shade(sample->frame, color, gradient, label, sample->ray->world);
    }
    const real share = choose(active, s->light * color.opacity, (real)(0.0f)), left = s->light * color.clear;
    s->red = madd(share, color.red, s->red);
    s->green = madd(share, color.green, s->green);
    s->blue = madd(share, color.blue, s->blue);
    const mask here = active & (s->light > 0.5f) & (left <= 0.5f);
    s->depth = choose(here, t, s->depth);
    s->face = choose_whole(here, (mask)(face ? ~0 : 0), s->face);
    s->light = choose(active, left, s->light);
}

INLINE void begin_in(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, const real label, const real t, const mask active)
{
    const ray_t *ray = sample->ray;
    const mask entry = active & (t <= madd((real)(AT_ENTRY), ray->step, ray->enter));
    if (any_lane(entry))
        enter_region(s, coefficients, sample, label, ray->enter, 1, entry);
    s->label = choose(active, label, s->label);
    s->before = choose(active, t, s->before);
    s->started |= active;
}

OUT_OF_LINE float lead_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z, const int one, const int other)
{
    const region_taps_t taps = taps_around(coefficients, sample->extent, locate_stored(sample, x, y, z));
    return weight_of(&taps, one) - weight_of(&taps, other);
}

// By how much the weight of one label exceeds that of another.
INLINE real lead_at(COEFFICIENTS coefficients, const sample_t *sample, const real t, const real one, const real other, const mask active)
{
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active }, ones = { to_mask(one) }, others = { to_mask(other) };
    lanes_u lead = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            lead.each[i] = lead_one(coefficients, sample, x.each[i], y.each[i], z.each[i], ones.each[i], others.each[i]);
    return lead.all;
}

// A guess of where one label's lead over another is lost: regula falsi that halves the value of an end that stays (Illinois).
INLINE real lead_lost(COEFFICIENTS coefficients, const sample_t *sample, real near, real far, const real one, const real other, const mask active)
{
    real ahead = lead_at(coefficients, sample, near, one, other, active), behind = lead_at(coefficients, sample, far, one, other, active);
    mask stayed = NONE;   // 1: the far end did, 2: the near one
    for (int i = 0;; ++i) {
        const real cut = near + (far - near) * (ahead / (ahead - behind));
        const real guess = choose((cut > near) & (cut < far), cut, 0.5f * (near + far));
        if (i == GUESSES)
            return guess;
        const real lead = lead_at(coefficients, sample, guess, one, other, active);
        const mask on = lead > 0.0f;
        behind = choose(on & (stayed == 1), 0.5f * behind, choose(on, behind, lead));
        ahead = choose(!on & (stayed == 2), 0.5f * ahead, choose(on, lead, ahead));
        stayed = choose_whole(on, (mask)(1), (mask)(2));
        near = choose(on, guess, near);
        far = choose(on, far, guess);
    }
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const ray_t *ray = sample->ray;
    const mask first = active & !s->started;
    if (any_lane(first))
        begin_in(s, coefficients, sample, value, t, first);
    // behind skipped samples, of which none is seen, the region is another one
    mask crossed = active & (s->label != value) & (t - s->before < 1.5f * ray->step);
    const real close = TOLERANCE / square_root(dot3(ray->direction, ray->direction));
    while (any_lane(crossed)) {
        real near = s->before, far = t, entered = value;
        const real guess = lead_lost(coefficients, sample, near, far, s->label, value, crossed);
        mask apart = crossed;
        for (int i = 0;; ++i) {
            // close by on both sides of the guess, which ends it unless a third label is there
            const real beside = guess + (i ? 0.49f : -0.49f) * close;
            const real middle = choose((mask)(i < 2 ? ~0 : 0) & (beside > near) & (beside < far), beside, 0.5f * (near + far));
            apart &= (far - near > close) & (middle > near) & (middle < far);
            if (!any_lane(apart))
                break;
            const real label = value_at(coefficients, sample, middle, apart);
            const mask before = label == s->label;
            near = choose(apart & before, middle, near);
            far = choose(apart & !before, middle, far);
            entered = choose(apart & !before, label, entered);
        }
        enter_region(s, coefficients, sample, entered, far, 0, crossed);
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
    begin_in(s, coefficients, sample, value, sample->ray->enter, active);
    return active & finished(s, sample->frame);
}

INLINE real place_of(const state_t *s) { return s->depth; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    const real opacity = 1.0f - s->light, per = 1.0f / MAX(opacity, (real)(1e-20f));
    const color_t color = { s->red * per, s->green * per, s->blue * per, opacity, s->light };
    return color;
}
