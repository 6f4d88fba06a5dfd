// The shading of a surface where rays hit it.

#include "march/sample.cl"
#include "march/light.cl"
#include "march/cap.cl"
#include "march/colored.cl"

// hit: where along the rays, or NOWHERE. capped: where that is on a cap, which is not lit.
INLINE color_t surface_color(COEFFICIENTS coefficients, const sample_t *sample, const real hit_t, const mask capped)
{
    constant float *surface = sample->frame->mode.color;
    const mask hit = hit_t < NOWHERE;
    color_t color = { (real)(surface[0]), (real)(surface[1]), (real)(surface[2]), choose(hit, (real)(1.0f), (real)(0.0f)), (real)(0.0f) };
    const real at = choose(hit, hit_t, sample->ray->enter);
    color_by(&color, coefficients, sample, at, hit);
    if (SHADED && any_lane(hit)) {
        const real3 gradient = gradient_at(coefficients, sample, at, hit);
        color = shade(sample, color, gradient, (real)(sample->frame->mode.isovalue), at, hit);
    }
    outline(&color, coefficients, sample, at, hit);
    if (any_lane(capped)) {
        const color_t cap = cap_color(sample, value_at(coefficients, sample, choose(capped, hit_t, sample->ray->enter), capped));
        color.red = choose(capped, cap.red, color.red);
        color.green = choose(capped, cap.green, color.green);
        color.blue = choose(capped, cap.blue, color.blue);
    }
    return color;
}
