// The caps that close surfaces at the faces of cuts, where values are not below the isovalue, the lowest of several.

#include "march/sample.cl"
#include "transfer/ramp.cl"

#define FACES(frame) ((frame)->mode.cap)
#define FACE_MATTERS(frame, low, high) ((frame)->mode.cap && (high) >= (frame)->mode.isovalue)

// The lanes that enter through a cap.
INLINE mask meets_cap(const sample_t *sample, const real value, const mask active)
{
    return active & (value >= sample->frame->mode.isovalue);
}

// Its colour there: a plain one, or those of the transfer function. It is not lit.
INLINE color_t cap_color(const sample_t *sample, const real value)
{
    constant float *plain = sample->frame->mode.cap_color;
    const color_t color = { (real)(plain[0]), (real)(plain[1]), (real)(plain[2]), (real)(1.0f), (real)(0.0f) };
    return sample->frame->mode.cap == 1 ? classify(&sample->frame->transfer, sample->table, value) : color;
}
