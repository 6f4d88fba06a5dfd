// What colours a surface by something else than its own colour, and draws its outline.
//
// Set by the host: CURVED, whether and by which curvature (curvature.cl), 0 by none; BY_LABEL, whether by the label behind it;
// OUTLINED, whether there are outlines.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#if CURVED | OUTLINED
#include "march/curvature.cl"
#endif

INLINE void color_by(color_t *color, COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
{
#if CURVED | BY_LABEL
    if (!any_lane(active))
        return;
#if CURVED
    const shape_t shape = shape_at(coefficients, sample, t, active);
    const color_t shown = classify(sample->frame, sample->table, curvature_of(&shape, sample->frame));
#else
    const color_t shown = classify(sample->frame, sample->table, value_at(coefficients, sample, t, active));
#endif
    color->red = shown.red;
    color->green = shown.green;
    color->blue = shown.blue;
#endif
}

// Darkens it in its outline.
INLINE void outline(color_t *color, COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
{
#if OUTLINED
    if (!any_lane(active))
        return;
    const shape_t shape = shape_at(coefficients, sample, t, active);
    const real rest = 1.0f - outline_of(&shape, sample, t);
    color->red *= rest;
    color->green *= rest;
    color->blue *= rest;
#endif
}
