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
INLINE void lane_taps(const row_t rows[LANES], real taps[ROW])
{
#if ROW == 8
#define LOW(i) rows[i].lo
#define HIGH(i) rows[i].hi
    const real low[4] = { FOURTHS(LOW, 0), FOURTHS(LOW, 1), FOURTHS(LOW, 2), FOURTHS(LOW, 3) };
    const real high[4] = { FOURTHS(HIGH, 0), FOURTHS(HIGH, 1), FOURTHS(HIGH, 2), FOURTHS(HIGH, 3) };
    transpose_fourths(low, taps);
    transpose_fourths(high, taps + 4);
#undef LOW
#undef HIGH
#elif ROW == 2 && LANES > 1
    const real low = *(const real_at *)rows, high = *(const real_at *)(rows + LANES / 2);
    taps[0] = (real)(low.even, high.even);
    taps[1] = (real)(low.odd, high.odd);
#else
    row_u row;
    lanes_u tap[ROW];
#pragma unroll
    for (int i = 0; i < LANES; ++i) {
        row.row = rows[i];
#pragma unroll
        for (int k = 0; k < ROW; ++k)
            tap[k].each[i] = row.each[k];
    }
#pragma unroll
    for (int k = 0; k < ROW; ++k)
        taps[k] = tap[k].all;
#endif
}
