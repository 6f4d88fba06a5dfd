// Kernel: bounds of the distance from a rendered surface to the true one, and of the angle to its normal.
//
// The host (uncertainty.py) computes the filter's error for waves, as stencils for each axis: the mean error of the value over
// all positions between two samples, and the deviations of the value and of the slope from their means. Here they are applied at
// the eight samples around a point.
//
// Set by the host: STORED, weights of a stencil; REACH, samples to each side with weights that are not 0; VALUE_IS_ODD, whether those
// of VALUE are odd, as those of ODD are; PLACES, positions between two samples at which the variance of noise is tabulated; the block
// uncertainty_t.

#include "base/platform.cl"
#include "spline/filter.cl"
#include "spline/fetch.cl"
#include "spline/taps.cl"
#include "uncertainty.h"

enum { MEAN, VALUE, EVEN, ODD, KINDS };   // of stencils

typedef struct {
    float value;      // mean square of the error
    float slope[3];   // mean squares of the variation of the slopes along x, y, z
    float mean[3];    // slopes of the mean error
} errors_t;

// The four samples across an axis, the first of which is at `at`.
INLINE float4 four(global const float *at, const size_t a, const size_t b) { return (float4)(at[0], at[a], at[b], at[a + b]); }

// The eight samples around a point, x fastest, from the four at either end of an axis.
INLINE float8 eight(const float8 ends, const int axis)
{
    return axis == 0 ? ends.s04152637 : axis == 1 ? ends.s01452367 : ends;
}

INLINE float sum_eight(const float8 v)
{
    const float4 a = v.lo + v.hi;
    return a.x + a.y + a.z + a.w;
}

// Along an axis, for both ends of each edge.
INLINE float8 differences(const float8 v, const int axis)
{
    return axis == 0 ? v.s11335577 - v.s00224466 : axis == 1 ? v.s23236767 - v.s01014545 : v.s45674567 - v.s01230123;
}

// Of the filter at an index position: squares are blended between the samples around it.
INLINE errors_t errors_at(global const float *samples, const int4 extent, constant uncertainty_t *u, const float at[3])
{
    const size_t step[3] = { 1, extent.x, (size_t)extent.x * extent.y };
    float8 weight = (float8)(1.0f);
    global const float *first = samples;
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int base = (int)(at[axis] + 1.0f) - 1;
        const float t = at[axis] - base, s = 1.0f - t;
        weight *= axis == 0 ? (float8)(s, t, s, t, s, t, s, t) : axis == 1 ? (float8)(s, s, t, t, s, s, t, t)
                                                                           : (float8)(s, s, s, s, t, t, t, t);
        first += (size_t)(base + extent.w) * step[axis];
    }
    float8 mean = (float8)(0.0f), value[3], slopes[3];
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        constant float *stencil = u->stencils + KINDS * STORED * axis + STORED / 2;   // its middle
        float4 v[2 * REACH + 2];
#pragma unroll
        for (int k = 0; k < 2 * REACH + 2; ++k)
            v[k] = four(first + (k - REACH) * (ptrdiff_t)step[axis], step[axis == 0], step[axis == 2 ? 1 : 2]);
        float8 sums[KINDS];
        const float8 middle = (float8)(v[REACH], v[REACH + 1]);   // at both ends of the cell
        for (int kind = 0; kind < KINDS; ++kind)
            sums[kind] = stencil[STORED * kind] * middle;
#pragma unroll
        for (int k = 1; k <= REACH; ++k) {
            const float8 after = (float8)(v[REACH + k], v[REACH + 1 + k]), before = (float8)(v[REACH - k], v[REACH + 1 - k]);
            const float8 even = after + before, odd = after - before;
            sums[MEAN] = madd((float8)(stencil[STORED * MEAN + k]), even, sums[MEAN]);
            sums[VALUE] = madd((float8)(stencil[STORED * VALUE + k]), VALUE_IS_ODD ? odd : even, sums[VALUE]);
            sums[EVEN] = madd((float8)(stencil[STORED * EVEN + k]), even, sums[EVEN]);
            sums[ODD] = madd((float8)(stencil[STORED * ODD + k]), odd, sums[ODD]);
        }
        mean += eight(sums[MEAN], axis);
        value[axis] = eight(sums[VALUE], axis);
        slopes[axis] = eight(sums[EVEN] * sums[EVEN] + sums[ODD] * sums[ODD], axis);
    }
    errors_t e;
    e.value = sum_eight(weight * (mean * mean + value[0] * value[0] + value[1] * value[1] + value[2] * value[2]));
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const float8 a = differences(value[(axis + 1) % 3], axis), b = differences(value[(axis + 2) % 3], axis);
        e.slope[axis] = sum_eight(weight * (slopes[axis] + a * a + b * b));
        e.mean[axis] = sum_eight(weight * differences(mean, axis));
    }
    return e;
}

// points: from the volume's centre, in mean spacings; NaN where there is none. results: world distance, degrees.
kernel void uncertainty(COEFFICIENTS coefficients, const int4 extent, global const float *samples, const int4 stored, const int4 size,
                        constant uncertainty_t *u, global const float *points, const int count, global float *results)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    global const float *p = points + 3 * (size_t)i;
    global float *result = results + 2 * (size_t)i;
    if (!(p[0] == p[0])) {
        result[0] = result[1] = NAN;
        return;
    }
    constant float *m = u->to_index;
    const float last[3] = { size.x - 0.5f, size.y - 0.5f, size.z - 0.5f };
    float at[3];
    int place[3];
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const float x = madd(m[3 * axis], p[0], madd(m[3 * axis + 1], p[1], madd(m[3 * axis + 2], p[2], u->center[axis])));
        at[axis] = MIN(MAX(x, -0.5f), last[axis]);
        const float t = at[axis] + 1.0f - (int)(at[axis] + 1.0f);
        place[axis] = PLACES * axis + MIN((int)(t * PLACES), PLACES - 1);
    }

    float value;
    gradient_t g = taps_gradient(coefficients, extent, locate_inner(at[0], at[1], at[2], extent.w), &value);
    g.x *= u->gain * GRID_SCALE; g.y *= u->gain * GRID_SCALE; g.z *= u->gain * GRID_SCALE;
    const float3 gradient = { madd(m[0], g.x, madd(m[3], g.y, m[6] * g.z)), madd(m[1], g.x, madd(m[4], g.y, m[7] * g.z)),
                              madd(m[2], g.x, madd(m[5], g.y, m[8] * g.z)) };
    const float square = gradient.x * gradient.x + gradient.y * gradient.y + gradient.z * gradient.z;
    value *= u->gain;
    const float rounding = u->rounding * (value * value + g.x * g.x + g.y * g.y + g.z * g.z);
    if (!(square > rounding * u->steepest)) {   // the slope is only rounding
        result[0] = INFINITY;
        result[1] = 180.0f;
        return;
    }

    const errors_t e = errors_at(samples, stored, u, at);
    const float x = u->squares[place[0]], y = u->squares[place[1]], z = u->squares[place[2]];
    const float noisy[3] = { u->slopes[place[0]] * y * z, x * u->slopes[place[1]] * z, x * y * u->slopes[place[2]] };
    const float off = MAX(e.value - u->power * u->noise[0], 0.0f) + u->power * x * y * z + rounding;
    float3 mean = (float3)(0.0f);   // slope of the mean error in the world
    float varying = 0.0f, expected = 0.0f, noise = 0.0f;
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const float3 row = { m[3 * axis], m[3 * axis + 1], m[3 * axis + 2] };   // the gradient of the index
        const float length = row.x * row.x + row.y * row.y + row.z * row.z;
        const float along = row.x * gradient.x + row.y * gradient.y + row.z * gradient.z;
        const float across = MAX(length - along * along / square, 0.0f);   // of the normal
        varying += across * (MAX(e.slope[axis] - u->power * u->noise[1 + axis], 0.0f) + u->power * noisy[axis] + rounding);
        expected += across * u->power * u->noise[4 + axis];
        noise += length * u->power * noisy[axis];
        mean += row * e.mean[axis];
    }
    const float along = mean.x * gradient.x + mean.y * gradient.y + mean.z * gradient.z;
    const float turned = mean.x * mean.x + mean.y * mean.y + mean.z * mean.z - along * along / square;
    const float slope = MAX(square - noise, u->least * square);
    result[0] = u->distance * sqrt(off / slope + u->placed);
    result[1] = MIN(u->degrees * sqrt((MAX(turned - expected, 0.0f) + varying) / slope), 180.0f);
}
