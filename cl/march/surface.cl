// The shading of a surface where rays hit it.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"

// hit: where along the rays, or NOWHERE.
INLINE color_t surface_color(COEFFICIENTS coefficients, const sample_t *sample, const real hit_t)
{
    constant float *surface = sample->frame->mode.color;
    const mask hit = hit_t < NOWHERE;
    color_t color = { (real)(surface[0]), (real)(surface[1]), (real)(surface[2]), choose(hit, (real)(1.0f), (real)(0.0f)), (real)(0.0f) };
    if (SHADED && any_lane(hit)) {
        const real3 gradient = gradient_at(coefficients, sample, choose(hit, hit_t, sample->ray->enter), hit);
        color = shade(sample->frame, color, gradient, (real)(sample->frame->mode.isovalue), sample->ray->world);
    }
    return color;
}
