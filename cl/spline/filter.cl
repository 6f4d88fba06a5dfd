// Weights of the taps of the current filter, and their first and second derivatives, at a fraction t past the cell's start: for
// one sample, a row of taps at a time; or for LANES samples, a tap at a time.
//
// A row is a vector of ROW taps, so that one load fetches it and one multiply-add weighs it. LANES samples take a vector of
// LANES weights for each tap; `lane_taps` brings their rows to that form.
//
// Set by the host (build.py, filter_defines): TAPS, DEGREE; ROW, the width of vectors that hold a row, at most 8 (PoCL 3.0
// aborts on float16 for some processors), and CHUNKS, how many of them do; FILTER_COLUMNS, whose column k holds the
// coefficients of t^k of all taps, zero past TAPS; FILTER_TAPS, the same tap by tap.

#include "base/platform.cl"
#include "base/lanes.cl"
#include "base/transpose.cl"

#if ROW == 1
typedef scalar row_t;
#else
typedef PASTE(SCALAR_TYPE, ROW) row_t;
#endif
typedef row_t row_at_t AT_ANY_ADDRESS;
typedef union { row_t row; scalar each[ROW]; } row_u;

constant row_t filter_columns[DEGREE + 1][CHUNKS] = FILTER_COLUMNS;
constant scalar filter_taps[TAPS][DEGREE + 1] = FILTER_TAPS;

// One chunk of the taps, by Horner's rule in the fractional position t.
INLINE row_t tap_weights(scalar t, int chunk)
{
    row_t w = filter_columns[DEGREE][chunk];
#pragma unroll
    for (int k = DEGREE - 1; k >= 0; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk]);
    return w;
}

// Their first derivatives ...
INLINE row_t tap_slopes(scalar t, int chunk)
{
#if DEGREE >= 1
    row_t w = filter_columns[DEGREE][chunk] * (scalar)DEGREE;
#pragma unroll
    for (int k = DEGREE - 1; k >= 1; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk] * (scalar)k);
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// ... and their second ones.
INLINE row_t tap_bends(scalar t, int chunk)
{
#if DEGREE >= 2
    row_t w = filter_columns[DEGREE][chunk] * (scalar)(DEGREE * (DEGREE - 1));
#pragma unroll
    for (int k = DEGREE - 1; k >= 2; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk] * (scalar)(k * (k - 1)));
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// The sum of a row. It is added by halves, in the same order on every device.
INLINE scalar row_sum(row_t v)
{
#if ROW == 1
    return v;
#elif ROW == 2
    return v.s0 + v.s1;
#else
#if ROW == 8
    scalar4 q = v.lo + v.hi;
#else
    scalar4 q = v;
#endif
    scalar2 p = q.lo + q.hi;
    return p.x + p.y;
#endif
}

#define WEIGHTS (CHUNKS * ROW)

// The weights of all taps one by one, and their derivatives.
#define UNPACK(name, of)                                     \
    INLINE void name(scalar t, scalar w[WEIGHTS])              \
    {                                                        \
        _Pragma("unroll") for (int i = 0; i < CHUNKS; ++i) { \
            row_u taps;                                      \
            taps.row = of(t, i);                             \
            _Pragma("unroll") for (int k = 0; k < ROW; ++k)  \
                w[i * ROW + k] = taps.each[k];               \
        }                                                    \
    }
UNPACK(unpack_weights, tap_weights)
UNPACK(unpack_slopes, tap_slopes)
UNPACK(unpack_bends, tap_bends)

// -- LANES samples ---------------------------------------------------------------------------------------------

// Their weights by Horner's rule, tap by tap, and the derivatives of these.
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

// Sums of weighted taps: taps[k] holds tap k of all samples.
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
#if ROW == 8 && LANES > 1
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
