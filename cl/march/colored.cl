// What colours a surface by something else than its own colour.
//
// Set by the host: CURVED, whether and by which curvature (curvature.cl), 0 by none; BY_LABEL, whether by the label behind it.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#if CURVED
#include "march/curvature.cl"
#endif

INLINE void color_by(color_t *color, COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
{
#if CURVED
#define SHOWN_VALUE curvature_at(coefficients, sample, t, active)
#elif BY_LABEL
#define SHOWN_VALUE value_at(coefficients, sample, t, active)
#endif
#ifdef SHOWN_VALUE
    if (!any_lane(active))
        return;
    const color_t shown = classify(sample->frame, sample->table, SHOWN_VALUE);
    color->red = shown.red;
    color->green = shown.green;
    color->blue = shown.blue;
#endif
}
