// The function along straight lines within a cell, for LANES of them: a polynomial of degree 3 DEGREE in Bernstein form.
//
// On a line from one point of a cell to another, the weight of a tap along an axis is a polynomial of degree DEGREE in the fraction
// u of the way. Sums and products of these are taken in scaled Bernstein form, whose coefficients C(n, j) b[j] multiply as those
// of ordinary polynomials do. The weights along x are summed over a row of taps, then rows over y, then slices over z.
//
// Where bounds are those of control points (HULL in minmax.cl) the results lie in the hull of the cell's own, up to rounding,
// which PAD_SIZE covers. Where they are bounds of values alone, coefficients may lie outside; roots may not.
//
// Set by the host: PASCAL, row m of whose table holds C(DEGREE - m, j - m) for j = 0 to DEGREE; BERNSTEIN_DEGREE and
// BERNSTEIN_CHOOSE, see bernstein.cl.

#include "base/bernstein.cl"
#include "base/transpose.cl"
#include "spline/fetch.cl"
#include "spline/filter.cl"

#define ORDER (DEGREE + 1)   // coefficients of a piece

constant float pascal[ORDER][ORDER] = PASCAL;

// The weight of each tap at fractions from x0 to x1 in scaled Bernstein form: by its Taylor polynomial about the smaller, so that
// powers of both are no larger than 1.
INLINE void weights_along(const real x0, const real x1, real w[TAPS][ORDER])
{
    const mask down = x1 < x0;
    const real start = MIN(x0, x1), span = magnitude(x1 - x0);
    UNROLL_TAPS
    for (int i = 0; i < TAPS; ++i) {
        real p[ORDER];
#pragma unroll
        for (int k = 0; k < ORDER; ++k)
            p[k] = (real)(filter_taps[i][k]);
#pragma unroll
        for (int m = 0; m < DEGREE; ++m)
#pragma unroll
            for (int k = DEGREE - 1; k >= m; --k)
                p[k] = madd(start, p[k + 1], p[k]);
        real power = span;
#pragma unroll
        for (int m = 1; m < ORDER; ++m) {
            p[m] *= power;
            power *= span;
        }
#pragma unroll
        for (int j = 0; j < ORDER; ++j) {
            w[i][j] = pascal[0][j] * p[0];
#pragma unroll
            for (int m = 1; m <= j; ++m)
                w[i][j] = madd((real)(pascal[m][j]), p[m], w[i][j]);
        }
#pragma unroll
        for (int j = 0; 2 * j < DEGREE; ++j) {
            const real forth = w[i][j], back = w[i][DEGREE - j];
            w[i][j] = choose(down, back, forth);
            w[i][DEGREE - j] = choose(down, forth, back);
        }
    }
}

// A row of taps of LANES cells: taps[i] holds tap i of all.
INLINE void fetch_taps(COEFFICIENTS coefficients, const int4 extent, const cursor_t slices[LANES], int j, real taps[WEIGHTS])
{
#if ROW == 4 && CHUNKS == 1 && LANES > 1
    real rows[4];
#define ROW_OF(i) fetch_row(coefficients, extent, slices[i], 0, j)
    rows[0] = FOURTHS(ROW_OF, 0);
    rows[1] = FOURTHS(ROW_OF, 1);
    rows[2] = FOURTHS(ROW_OF, 2);
    rows[3] = FOURTHS(ROW_OF, 3);
#undef ROW_OF
    transpose_fourths(rows, taps);
#else
#pragma unroll
    for (int h = 0; h < CHUNKS; ++h) {
        row_t rows[LANES];
        for (int i = 0; i < LANES; ++i)
            rows[i] = fetch_row(coefficients, extent, slices[i], h * ROW, j);
        lane_taps(rows, taps + h * ROW);
    }
#endif
}

// On lines from (x0, y0, z0) to (x1, y1, z1), in fractions of the cells whose first taps lie at `slices`.
OUT_OF_LINE void function_along(COEFFICIENTS coefficients, const int4 extent, cursor_t slices[LANES], const real x0, const real x1,
                                const real y0, const real y1, const real z0, const real z1, real q[COEFFICIENT_COUNT])
{
    real wx[TAPS][ORDER], wy[TAPS][ORDER], wz[TAPS][ORDER];
    weights_along(x0, x1, wx);
    weights_along(y0, y1, wy);
    weights_along(z0, z1, wz);
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        q[j] = (real)(0.0f);
#pragma unroll 1
    for (int k = 0; k < TAPS; ++k) {
        real slice[2 * DEGREE + 1];
#pragma unroll
        for (int j = 0; j < 2 * DEGREE + 1; ++j)
            slice[j] = (real)(0.0f);
#pragma unroll 1
        for (int j = 0; j < TAPS; ++j) {
            real taps[WEIGHTS];
            fetch_taps(coefficients, extent, slices, j, taps);
#pragma unroll
            for (int m = 0; m < ORDER; ++m) {
                real row = wx[0][m] * taps[0];
#pragma unroll
                for (int i = 1; i < TAPS; ++i)
                    row = madd(wx[i][m], taps[i], row);
#pragma unroll
                for (int n = 0; n < ORDER; ++n)
                    slice[m + n] = madd(row, wy[j][n], slice[m + n]);
            }
        }
#pragma unroll
        for (int m = 0; m < 2 * DEGREE + 1; ++m)
#pragma unroll
            for (int n = 0; n < ORDER; ++n)
                q[m + n] = madd(slice[m], wz[k][n], q[m + n]);
        for (int i = 0; i < LANES; ++i)
            slices[i] = next_slice(coefficients, extent, slices[i]);
    }
#pragma unroll
    for (int j = 0; j < COEFFICIENT_COUNT; ++j)
        q[j] *= 1.0f / bernstein_choose[j];
}
