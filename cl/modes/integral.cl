// The line integral along the ray, coloured by the transfer function. It has no depth.

#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real sum; } state_t;   // of stored values, times lengths in mean spacings

#include "modes/sums.cl"

INLINE void begin(state_t *s) { s->sum = (real)(0.0f); }

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    s->sum = choose(active, madd(length_of(sample, t, active), height_of(sample->frame, value), s->sum), s->sum);
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back) { front->sum += back->sum; }
