// Rows to columns: of rows of four taps, one row for each of LANES samples; and of blocks of eight rows of a volume.
//
// Both exchange elements only within quarters of a register: exchanges between quarters take three times as long.

#include "base/lanes.cl"

#if LANES > 1

// Lanes i, i + 4, ... share a vector of rows of four, so that nothing leaves its part of a register on the way.
#if LANES == 16
#define FOURTHS(row, i) (real)(row(i), row(i + 4), row(i + 8), row(i + 12))
#define EACH_0(v) (v).s000044448888cccc
#define EACH_1(v) (v).s111155559999dddd
#define EACH_2(v) (v).s22226666aaaaeeee
#define EACH_3(v) (v).s33337777bbbbffff
#define WEAVE_LOW(a, b) __builtin_shufflevector(a, b, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29)
#define WEAVE_HIGH(a, b) __builtin_shufflevector(a, b, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31)
#define PAIR_LOW(a, b) __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29)
#define PAIR_HIGH(a, b) __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31)
#else
#define FOURTHS(row, i) (real)(row(i), row(i + 4))
#define EACH_0(v) (v).s00004444
#define EACH_1(v) (v).s11115555
#define EACH_2(v) (v).s22226666
#define EACH_3(v) (v).s33337777
#define WEAVE_LOW(a, b) (real)((a).s0, (b).s0, (a).s1, (b).s1, (a).s4, (b).s4, (a).s5, (b).s5)
#define WEAVE_HIGH(a, b) (real)((a).s2, (b).s2, (a).s3, (b).s3, (a).s6, (b).s6, (a).s7, (b).s7)
#define PAIR_LOW(a, b) (real)((a).s01, (b).s01, (a).s45, (b).s45)
#define PAIR_HIGH(a, b) (real)((a).s23, (b).s23, (a).s67, (b).s67)
#endif

// From rows[i], those of lanes i, i + 4, ..., to four vectors of all lanes; or back. The two may be the same array.
INLINE void transpose_fourths(const real rows[4], real lanes[4])
{
    const real a = WEAVE_LOW(rows[0], rows[1]), b = WEAVE_LOW(rows[2], rows[3]);
    const real c = WEAVE_HIGH(rows[0], rows[1]), d = WEAVE_HIGH(rows[2], rows[3]);
    lanes[0] = PAIR_LOW(a, b);
    lanes[1] = PAIR_HIGH(a, b);
    lanes[2] = PAIR_LOW(c, d);
    lanes[3] = PAIR_HIGH(c, d);
}

#endif

#if LANES == 8

// -- blocks of eight rows and eight columns -------------------------------------------------------------------

// v[i] becomes column i of the block. Rows past the last of `rows` repeat that.
INLINE void load_columns(real v[8], global const scalar *block, const size_t pitch, const int rows)
{
#define HALF_AT(row, column) (*(global const scalar4_at *)(block + ((row) < rows ? (row) : rows - 1) * pitch + (column)))
#pragma unroll
    for (int i = 0; i < 4; ++i) {
        v[i] = (real)(HALF_AT(i, 0), HALF_AT(i + 4, 0));
        v[i + 4] = (real)(HALF_AT(i, 4), HALF_AT(i + 4, 4));
    }
    transpose_fourths(v, v);
    transpose_fourths(v + 4, v + 4);
}

INLINE void store_columns(real v[8], global scalar *block, const size_t pitch, const int rows)
{
    transpose_fourths(v, v);
    transpose_fourths(v + 4, v + 4);
#define STORE_ROW(row, half)                                               \
    {                                                                      \
        *(global scalar4_at *)(block + (row) * pitch) = v[i].half;          \
        *(global scalar4_at *)(block + (row) * pitch + 4) = v[i + 4].half;  \
    }
#pragma unroll
    for (int i = 0; i < 4; ++i)
        if (rows == 8) {
            STORE_ROW(i, lo)
            STORE_ROW(i + 4, hi)
        } else {
            if (i < rows)
                STORE_ROW(i, lo)
            if (i + 4 < rows)
                STORE_ROW(i + 4, hi)
        }
}

#endif
