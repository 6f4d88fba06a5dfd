// The maximum along the ray of values that fade with depth: what is near stands out, as in a projection through fog.
//
// A value counts from the transfer function's first point up, times exp(-attenuation d), with d from 0 at the front of the
// volume's bounding sphere to 1 at its back.

typedef struct { real best, t; } state_t;

#define REACH 0.0f
#define ANY_ORDER 1
#define PROMISE(low, high) (high)   // before it fades

INLINE void begin(state_t *s)
{
    s->best = (real)(0.0f);
    s->t = NOWHERE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return NONE; }

// t counts from the plane through the volume's centre, whose distance from the front is half of the sphere's diameter.
INLINE real faded(constant frame_t *frame, real value, real t)
{
    const real height = MAX(value - frame->transfer.low, (real)(0.0f));
    return height * exp_2(frame->mode.fade * MAX(t + frame->mode.front, (real)(0.0f)));
}

// Of equal heights the first counts, in whichever order they come.
INLINE mask replaces(const state_t *s, real height, real t)
{
    return (height > s->best) | ((height == s->best) & (t < s->t)) | (s->t == NOWHERE);
}

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    const real highest = 1.00001f * faded(frame, (real)(high), t);   // exp_2 errs by 3e-7 either way
    return any_lane(active & replaces(s, highest, t));
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const real height = faded(sample->frame, value, t);
    const mask better = active & replaces(s, height, t);
    s->best = choose(better, height, s->best);
    s->t = choose(better, t, s->t);
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    const mask better = (back->t < NOWHERE) & replaces(front, back->best, back->t);
    front->best = choose(better, back->best, front->best);
    front->t = choose(better, back->t, front->t);
}

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real *t)
{
    color_t color = classify(sample->frame, sample->table, sample->frame->transfer.low + s->best);
    color.opacity = choose(s->t < NOWHERE, (real)(1.0f), (real)(0.0f));
    *t = s->t;
    return color;
}
