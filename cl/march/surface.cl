// The shading of a surface where rays hit it, and the caps that close it at the faces of cuts.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"

#define FACES(frame) ((frame)->mode.cap)
#define FACE_MATTERS(frame, low, high) ((frame)->mode.cap && (high) >= (frame)->mode.isovalue)

// The lanes that enter through a cap.
INLINE mask meets_cap(const sample_t *sample, const real value, const mask active)
{
    return active & (value >= sample->frame->mode.isovalue);
}

// hit: where along the rays, or NOWHERE. capped: where that is on a cap, which is not lit.
INLINE color_t surface_color(COEFFICIENTS coefficients, const sample_t *sample, const real hit_t, const mask capped)
{
    constant float *surface = sample->frame->mode.color;
    const mask hit = hit_t < NOWHERE;
    color_t color = { (real)(surface[0]), (real)(surface[1]), (real)(surface[2]), choose(hit, (real)(1.0f), (real)(0.0f)), (real)(0.0f) };
    if (SHADED && any_lane(hit)) {
        const real3 gradient = gradient_at(coefficients, sample, choose(hit, hit_t, sample->ray->enter), hit);
        color = shade(sample->frame, color, gradient, (real)(sample->frame->mode.isovalue), sample->ray->world);
    }
    if (any_lane(capped)) {
        constant float *plain = sample->frame->mode.cap_color;
        color_t cap = { (real)(plain[0]), (real)(plain[1]), (real)(plain[2]), color.opacity, color.clear };
        if (sample->frame->mode.cap == 1)
            cap = classify(sample->frame, sample->table, value_at(coefficients, sample, choose(capped, hit_t, sample->ray->enter), capped));
        color.red = choose(capped, cap.red, color.red);
        color.green = choose(capped, cap.green, color.green);
        color.blue = choose(capped, cap.blue, color.blue);
    }
    return color;
}
