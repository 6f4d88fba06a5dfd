// The surfaces of a picture of several: isovalues in ascending order, each with a colour and an opacity.
//
// Set before: SURFACES, SOUGHT (walk.cl).

#include "base/lanes.cl"
#include "transfer/ramp.cl"
#include "frame.cl"

// Whether some surface is between values.
INLINE int layer_within(constant frame_t *frame, const float low, const float high)
{
    int some = 0;
    for (int k = 0; k < SURFACES(frame); ++k)
        some |= !(low > SOUGHT(frame, k) || high < SOUGHT(frame, k));
    return some;
}

// The look of surface number `which`, and its isovalue.
INLINE color_t layer_of(constant frame_t *frame, const real which, real *value)
{
    color_t color = { (real)(0.0f), (real)(0.0f), (real)(0.0f), (real)(0.0f), (real)(0.0f) };
    *value = (real)(0.0f);
    for (int k = 0; k < SURFACES(frame); ++k) {
        constant float *own = frame->mode.colors + 4 * k;
        const mask here = which == (real)(k);
        color.red = choose(here, (real)(own[0]), color.red);
        color.green = choose(here, (real)(own[1]), color.green);
        color.blue = choose(here, (real)(own[2]), color.blue);
        color.opacity = choose(here, (real)(own[3]), color.opacity);
        *value = choose(here, (real)(SOUGHT(frame, k)), *value);
    }
    return color;
}
