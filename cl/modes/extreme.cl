// The greatest or the least value among a ray's samples, coloured by the transfer function.
// Set by the including mode: BEYOND(a, b), whether a replaces b; EXTREME(low, high), which of the two matters.

typedef struct { real best, t; } state_t;

INLINE void begin(state_t *s)
{
    s->best = (real)(0.0f);
    s->t = NOWHERE;
}

#define REACH 0.0f
#define ANY_ORDER 1

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    const real extreme = (real)(EXTREME(low, high));
    return any_lane(active & (BEYOND(extreme, s->best) | ((extreme == s->best) & (t < s->t)) | (s->t == NOWHERE)));
}

INLINE mask gather(state_t *s, SCENE_PARAMS, real t, real value, mask active)
{
    // of equal ones the first, in whichever order they come
    const mask better = active & (BEYOND(value, s->best) | ((value == s->best) & (t < s->t)) | (s->t == NOWHERE));
    s->best = choose(better, value, s->best);
    s->t = choose(better, t, s->t);
    return NONE;
}

INLINE color_t finish(const state_t *s, SCENE_PARAMS, real *t)
{
    color_t color = classify(frame, table, s->best);
    color.opacity = choose(s->t < NOWHERE, (real)(1.0f), (real)(0.0f));
    *t = s->t;
    return color;
}
