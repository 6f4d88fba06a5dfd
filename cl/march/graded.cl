// The opacity of a sample by more than its value: by the gradient there, and by curvature (transfer/graded.cl).

#include "march/sample.cl"

#if GRADED

#include "transfer/graded.cl"
#if GRADED & 2
#include "march/curvature.cl"
#endif

// The colour of samples at t, where classify has seen some, with all that their opacity depends on.
INLINE color_t graded(COEFFICIENTS coefficients, const sample_t *sample, const real t, const real value, const real3 gradient,
                      color_t color, const mask seen)
{
    constant frame_t *frame = sample->frame;
#if GRADED & 5
    const real steepness = square_root(dot3(gradient, gradient));
#endif
#if GRADED & 4
    color = classify_jointly(&frame->joint, sample->table, value, steepness);
#endif
#if GRADED & 1
    color = thinned(color, factor_of(&frame->factors, BY_GRADIENT, steepness));
#endif
#if GRADED & 2
    const shape_t shape = shape_at(coefficients, sample, t, seen & (color.opacity > 0.0f));
    color = thinned(color, factor_of(&frame->factors, BY_CURVATURE, most_bent(&shape, frame)));
#endif
    color.opacity = choose(seen, color.opacity, (real)(0.0f));
    return color;
}

#if GRADED & 5

#define SLOPES 1
#define SLOPES_MATTER(frame, table, bounds) slopes_matter(frame, table, (bounds)->values, (bounds)->slopes)

INLINE int slopes_matter(constant frame_t *frame, global const float4 *table, const float2 values, const float2 slopes)
{
#if GRADED & 4
    if (transparent_jointly(&frame->joint, table, values, slopes))
        return 0;
#endif
#if GRADED & 1
    if (none_within(&frame->factors, BY_GRADIENT, slopes.x, slopes.y))
        return 0;
#endif
    return 1;
}

#endif
#endif
