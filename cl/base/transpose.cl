// Eight rows at once: a block of eight columns, each in a vector, from memory that holds rows, and back.

#define LANES 8

// at any address that is a multiple of four
typedef float4 half_at_t __attribute__((aligned(4)));
typedef float8 lanes_at_t __attribute__((aligned(4)));

// Four columns of rows 0 to 3 and of rows 4 to 7 become four rows of eight, or the other way.
INLINE void transpose_halves(float8 v[4])
{
    const float8 a = (float8)(v[0].s0, v[1].s0, v[0].s1, v[1].s1, v[0].s4, v[1].s4, v[0].s5, v[1].s5);
    const float8 b = (float8)(v[0].s2, v[1].s2, v[0].s3, v[1].s3, v[0].s6, v[1].s6, v[0].s7, v[1].s7);
    const float8 c = (float8)(v[2].s0, v[3].s0, v[2].s1, v[3].s1, v[2].s4, v[3].s4, v[2].s5, v[3].s5);
    const float8 d = (float8)(v[2].s2, v[3].s2, v[2].s3, v[3].s3, v[2].s6, v[3].s6, v[2].s7, v[3].s7);
    v[0] = (float8)(a.s01, c.s01, a.s45, c.s45);
    v[1] = (float8)(a.s23, c.s23, a.s67, c.s67);
    v[2] = (float8)(b.s01, d.s01, b.s45, d.s45);
    v[3] = (float8)(b.s23, d.s23, b.s67, d.s67);
}

// v[i] becomes column i of the block. Rows past the last of `rows` repeat that.
INLINE void load_columns(float8 v[LANES], global const float *block, const size_t pitch, const int rows)
{
#define HALF_AT(row, column) (*(global const half_at_t *)(block + ((row) < rows ? (row) : rows - 1) * pitch + (column)))
#pragma unroll
    for (int i = 0; i < 4; ++i) {
        v[i] = (float8)(HALF_AT(i, 0), HALF_AT(i + 4, 0));
        v[i + 4] = (float8)(HALF_AT(i, 4), HALF_AT(i + 4, 4));
    }
    transpose_halves(v);
    transpose_halves(v + 4);
}

INLINE void store_columns(float8 v[LANES], global float *block, const size_t pitch, const int rows)
{
    transpose_halves(v);
    transpose_halves(v + 4);
#define STORE_ROW(row, half)                                               \
    {                                                                      \
        *(global half_at_t *)(block + (row) * pitch) = v[i].half;          \
        *(global half_at_t *)(block + (row) * pitch + 4) = v[i + 4].half;  \
    }
#pragma unroll
    for (int i = 0; i < 4; ++i)
        if (rows == LANES) {
            STORE_ROW(i, lo)
            STORE_ROW(i + 4, hi)
        } else {
            if (i < rows)
                STORE_ROW(i, lo)
            if (i + 4 < rows)
                STORE_ROW(i + 4, hi)
        }
}
