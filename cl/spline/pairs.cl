// Value and gradient at one point by paired fetches: one linear fetch serves two taps along each axis (Sigg and Hadwiger, GPU
// Gems 2, chapter 20). Four taps per axis take 8 fetches in 3-D and 4 in 2-D, six taps take 27 and 9.
//
// Weights must have the same sign within each pair; otherwise the value, or the gradient, falls back to direct taps.
//
// Set by the host: PAIRED_VALUE and PAIRED_GRADIENT, whether pairs of weights, and of their derivatives, share their sign
// (Filter.pairable) and are requested.

#include "spline/taps.cl"

#if SIDE == 1   // sums of two points at once take direct taps

#define PAIRS ((TAPS + 1) / 2)

// w0 f(0) + w1 f(1) = (w0 + w1) times a linear fetch at w1 / (w0 + w1), if the two share their sign.
INLINE void pair_up(const scalar w[WEIGHTS], scalar weight[PAIRS], scalar place[PAIRS])
{
#pragma unroll
    for (int i = 0; i < PAIRS; ++i) {
        const scalar second = 2 * i + 1 < TAPS ? w[2 * i + 1] : 0.0f;
        weight[i] = w[2 * i] + second;
        place[i] = 2 * i + (weight[i] != 0.0f ? second / weight[i] : 0.0f);
    }
}

INLINE void weight_pairs(scalar t, scalar weight[PAIRS], scalar place[PAIRS])
{
    scalar w[WEIGHTS];
    unpack_weights(t, w);
    pair_up(w, weight, place);
}

INLINE void slope_pairs(scalar t, scalar weight[PAIRS], scalar place[PAIRS])
{
    scalar w[WEIGHTS];
    unpack_slopes(t, w);
    pair_up(w, weight, place);
}

INLINE scalar pairs_sum(COEFFICIENTS coefficients, const int4 extent, cell_t c, const scalar *ax, const scalar *ay, const scalar *az,
                         const scalar *px, const scalar *py, const scalar *pz)
{
    scalar sum = 0.0f;
#pragma unroll
    for (int k = 0; k < (DIMENSIONS == 3 ? PAIRS : 1); ++k) {
        scalar plane = 0.0f;
#pragma unroll
        for (int j = 0; j < (DIMENSIONS >= 2 ? PAIRS : 1); ++j) {
            scalar line = 0.0f;
#pragma unroll
            for (int i = 0; i < PAIRS; ++i)
                line = madd(ax[i], fetch_linear(coefficients, extent, c.x + px[i], c.y + py[j], c.z + pz[k]), line);
            plane = madd(ay[j], line, plane);
        }
        sum = madd(az[k], plane, sum);
    }
    return sum;
}

INLINE scalar pairs_value(COEFFICIENTS coefficients, const int4 extent, cell_t c)
{
    scalar ax[PAIRS], ay[PAIRS], az[PAIRS], px[PAIRS], py[PAIRS], pz[PAIRS];
    weight_pairs(c.tx, ax, px);
#if DIMENSIONS >= 2
    weight_pairs(c.ty, ay, py);
#else
    ay[0] = 1.0f; py[0] = 0.0f;
#endif
#if DIMENSIONS == 3
    weight_pairs(c.tz, az, pz);
#else
    az[0] = 1.0f; pz[0] = 0.0f;
#endif
    return pairs_sum(coefficients, extent, c, ax, ay, az, px, py, pz);
}

INLINE gradient_t pairs_gradient(COEFFICIENTS coefficients, const int4 extent, cell_t c, scalar *value)
{
    scalar ax[PAIRS], ay[PAIRS], az[PAIRS], px[PAIRS], py[PAIRS], pz[PAIRS], s[PAIRS], q[PAIRS];
    gradient_t g;
    weight_pairs(c.tx, ax, px);
#if DIMENSIONS >= 2
    weight_pairs(c.ty, ay, py);
#else
    ay[0] = 1.0f; py[0] = 0.0f;
#endif
#if DIMENSIONS == 3
    weight_pairs(c.tz, az, pz);
    slope_pairs(c.tz, s, q);
    g.z = pairs_sum(coefficients, extent, c, ax, ay, s, px, py, q);
#else
    az[0] = 1.0f; pz[0] = 0.0f; g.z = 0.0f;
#endif
    *value = pairs_sum(coefficients, extent, c, ax, ay, az, px, py, pz);
    slope_pairs(c.tx, s, q);
    g.x = pairs_sum(coefficients, extent, c, s, ay, az, q, py, pz);
#if DIMENSIONS >= 2
    slope_pairs(c.ty, s, q);
    g.y = pairs_sum(coefficients, extent, c, ax, s, az, px, q, pz);
#else
    g.y = 0.0f;
#endif
    return g;
}

// -- by either way --------------------------------------------------------------------------------------------

INLINE scalar sample_value(COEFFICIENTS coefficients, const int4 extent, cell_t c)
{
#if PAIRED_VALUE
    return pairs_value(coefficients, extent, c);
#else
    return taps_value(coefficients, extent, c);
#endif
}

// The gradient per stored coefficient, and the value beside it.
INLINE gradient_t sample_gradient(COEFFICIENTS coefficients, const int4 extent, cell_t c, scalar *value)
{
#if PAIRED_VALUE && PAIRED_GRADIENT
    return pairs_gradient(coefficients, extent, c, value);
#else
    return taps_gradient(coefficients, extent, c, value);
#endif
}

#endif
