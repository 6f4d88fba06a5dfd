// The sample of the highest rank on a ray, coloured by the transfer function.
//
// Set by the including mode: RANK(frame, value, t), the rank of a sample; BEYOND(a, b), whether rank a beats b;
// FURTHEST(frame, low, high, t), a rank that no value from low to high beats at t or past it; SHOWN(frame, rank), the value
// for the transfer function; PROMISE.

#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real best, t; } state_t;

#define REACH 0.0f
#define ANY_ORDER 1

INLINE void begin(state_t *s)
{
    s->best = (real)(0.0f);
    s->t = NOWHERE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return NONE; }

// Of equal ranks the first along the ray counts, whatever the order of gathering.
INLINE mask replaces(const state_t *s, real rank, real t)
{
    return BEYOND(rank, s->best) | ((rank == s->best) & (t < s->t)) | (s->t == NOWHERE);
}

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return any_lane(active & replaces(s, FURTHEST(frame, low, high, t), t));
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const real rank = RANK(sample->frame, value, t);
    const mask better = active & replaces(s, rank, t);
    s->best = choose(better, rank, s->best);
    s->t = choose(better, t, s->t);
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    const mask better = (back->t < NOWHERE) & replaces(front, back->best, back->t);
    front->best = choose(better, back->best, front->best);
    front->t = choose(better, back->t, front->t);
}

INLINE real place_of(const state_t *s) { return s->t; }

#define VALUE_OF(s, sample) choose((s)->t < NOWHERE, SHOWN((sample)->frame, (s)->best), (real)(NAN))

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    color_t color = classify(&sample->frame->transfer, sample->table, SHOWN(sample->frame, s->best));
    color.opacity = choose(s->t < NOWHERE, (real)(1.0f), (real)(0.0f));
    return color;
}
