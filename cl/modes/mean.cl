// The mean of the samples along the ray, coloured by the transfer function; it lies nowhere in depth.

#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real sum, count; } state_t;

#define REACH 0.0f
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s) { s->sum = s->count = (real)(0.0f); }

INLINE mask finished(const state_t *s, constant frame_t *frame) { return NONE; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return 1;   // every sample counts
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    s->sum += choose(active, value, (real)(0.0f));
    s->count += choose(active, (real)(1.0f), (real)(0.0f));
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    front->sum += back->sum;
    front->count += back->count;
}

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real *t)
{
    color_t color = classify(sample->frame, sample->table, s->sum / MAX(s->count, (real)(1.0f)));
    color.opacity = choose(s->count > 0.0f, (real)(1.0f), (real)(0.0f));
    *t = NOWHERE;
    return color;
}
