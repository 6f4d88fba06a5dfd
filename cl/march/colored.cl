// What colours matter and surfaces by something else than their own value or colour, and draws outlines.
//
// Set by the host: CURVED, whether by a curvature (curvature.cl); BY_DISTANCE, whether by the distance; BY_LABEL, whether by the label
// behind a surface; COLORED, whether by another function, of MOST_TAPS taps at most; OUTLINED, whether there are outlines.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#if CURVED | OUTLINED
#include "march/curvature.cl"
#endif

#if COLORED

// The other function is evaluated tap by tap, by a filter of its own. Its numbers lie in `table`: its transfer function's; the
// polynomials of its weights, taps × (degree + 1); and its coefficients.

// The weights of taps at a position along an axis, and the number of the first; all are stored, whatever the rounding.
INLINE int weights_at(constant function_block *function, const int axis, global const float *polynomials, const float x, float *weights)
{
    const float u = x * function->scale - function->left, base = floor(u), t = u - base;
    for (int i = 0; i < function->taps; ++i, polynomials += function->degree + 1) {
        weights[i] = polynomials[function->degree];
        for (int k = function->degree - 1; k >= 0; --k)
            weights[i] = madd(weights[i], t, polynomials[k]);
    }
    const int first = (int)base + function->halo, last = function->stored[axis] - function->taps;
    return MIN(MAX(first, 0), last);
}

INLINE float function_at(constant function_block *function, global const float *numbers, const float x, const float y, const float z)
{
    float along[MOST_TAPS], across[MOST_TAPS], deep[MOST_TAPS], value = 0.0f;
    global const float *polynomials = numbers + function->polynomials;
    const int i = weights_at(function, 0, polynomials, x, along), j = weights_at(function, 1, polynomials, y, across);
    const int k = weights_at(function, 2, polynomials, z, deep);
    const size_t pitch = function->stored[0], area = pitch * function->stored[1];
    global const float *first = numbers + function->coefficients + k * area + j * pitch + i;
    for (int c = 0; c < function->taps; ++c) {
        float plane = 0.0f;
        for (int b = 0; b < function->taps; ++b) {
            float row = 0.0f;
            for (int a = 0; a < function->taps; ++a)
                row = madd(along[a], first[c * area + b * pitch + a], row);
            plane = madd(across[b], row, plane);
        }
        value = madd(deep[c], plane, value);
    }
    return value;
}

// The other function at a position of this one's samples; false where it has no value.
INLINE int other_at(constant colored_block *colored, global const float *numbers, const float x, const float y, const float z, float *value)
{
    constant float *m = colored->to;
    const float u = madd(m[0], x, madd(m[1], y, madd(m[2], z, m[9])));
    const float v = madd(m[3], x, madd(m[4], y, madd(m[5], z, m[10])));
    const float w = madd(m[6], x, madd(m[7], y, madd(m[8], z, m[11])));
    constant float *low = colored->low, *high = colored->high;
    if (!(u >= low[0] & u <= high[0] & v >= low[1] & v <= high[1] & w >= low[2] & w <= high[2]))
        return 0;
    if (colored->some_missing && function_at(&colored->missing, numbers, u, v, w) > 0.5f)
        return 0;
    *value = function_at(&colored->function, numbers, u, v, w);
    return 1;
}

#endif

// Another function covers these colours where it has values, as far as it is opaque.
INLINE void color_by(color_t *color, COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
{
#if COLORED | CURVED | BY_DISTANCE | BY_LABEL
    if (!any_lane(active))
        return;
#endif
#if CURVED | BY_DISTANCE | BY_LABEL
#if CURVED
    const shape_t shape = shape_at(coefficients, sample, t, active);
    const real by = curvature_of(&shape, sample->frame);
#elif BY_DISTANCE
    const real by = t * sample->frame->geometry.unit;
#else
    const real by = value_at(coefficients, sample, t, active);
#endif
    const color_t own = classify(&sample->frame->transfer, sample->table, by);
    color->red = own.red;
    color->green = own.green;
    color->blue = own.blue;
#endif
#if COLORED
    constant colored_block *colored = &sample->frame->colored;
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u value = { (real)(0.0f) }, there = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            there.each[i] = (float)other_at(colored, (global const float *)sample->table, x.each[i], y.each[i], z.each[i], value.each + i);
    const color_t shown = classify(&colored->transfer, sample->table + colored->table, value.all);
    const real share = shown.opacity * there.all, rest = 1.0f - share;
    color->red = madd(share, shown.red, rest * color->red);
    color->green = madd(share, shown.green, rest * color->green);
    color->blue = madd(share, shown.blue, rest * color->blue);
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
