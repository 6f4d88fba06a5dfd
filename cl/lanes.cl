// LANES samples at once: weights, and rows of taps, one for each sample, as a vector for each tap.

// Weights of LANES samples at once: by Horner's rule, tap by tap.
INLINE void lane_weights(real t, real w[TAPS])
{
#pragma unroll
    for (int i = 0; i < TAPS; ++i) {
        w[i] = (real)(filter_taps[i][DEGREE]);
#pragma unroll
        for (int k = DEGREE - 1; k >= 0; --k)
            w[i] = madd(w[i], t, filter_taps[i][k]);
    }
}

INLINE void lane_slopes(real t, real w[TAPS])
{
#pragma unroll
    for (int i = 0; i < TAPS; ++i) {
        w[i] = (real)(DEGREE * filter_taps[i][DEGREE]);
#pragma unroll
        for (int k = DEGREE - 1; k >= 1; --k)
            w[i] = madd(w[i], t, k * filter_taps[i][k]);
    }
}

// Tap k of all samples is taps[k].
INLINE real lane_dot(const real taps[TAPS], const real w[TAPS])
{
    real sum = w[0] * taps[0];
#pragma unroll
    for (int k = 1; k < TAPS; ++k)
        sum = madd(w[k], taps[k], sum);
    return sum;
}

// From a row of taps for each sample to vectors of all samples, one for each tap.
INLINE void lane_taps(const row_u rows[LANES], real taps[ROW])
{
#if ROW >= 4
    real halves[4];
#pragma unroll
    for (int h = 0; h < ROW; h += 4) {
#define PART(i) *(const float4 *)(rows[i].each + h)
#pragma unroll
        for (int i = 0; i < 4; ++i)
            halves[i] = FOURTHS(PART, i);
#undef PART
        transpose_fourths(halves, taps + h);
    }
#else
#pragma unroll
    for (int k = 0; k < ROW; ++k) {
        lanes_u tap;
#pragma unroll
        for (int i = 0; i < LANES; ++i)
            tap.each[i] = rows[i].each[k];
        taps[k] = tap.all;
    }
#endif
}
