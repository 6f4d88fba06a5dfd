// Tap weights of the current filter and their derivatives: the only code that knows DEGREE.
//
// Set by the host from the filter's row (filters.py): TAPS, DEGREE, FILTER_COLUMNS: column k holds the
// coefficients of t^k of all taps, zero past TAPS; ROW, the vector width that covers them, or 8 if
// they are more, and CHUNKS, how many such vectors do. (PoCL 3.0 aborts on float16 for some processors.)

#if ROW == 1
typedef float row_t;
#else
typedef PASTE(float, ROW) row_t;
#endif
// the same at any address that is a multiple of four
typedef row_t row_at_t __attribute__((aligned(4)));
typedef union { row_t row; float each[ROW]; } row_u;

constant row_t filter_columns[DEGREE + 1][CHUNKS] = FILTER_COLUMNS;
constant float filter_taps[TAPS][DEGREE + 1] = FILTER_TAPS;   // the same, tap by tap

// One chunk of the taps, by Horner's rule in the fractional position t.
INLINE row_t tap_weights(float t, int chunk)
{
    row_t w = filter_columns[DEGREE][chunk];
#pragma unroll
    for (int k = DEGREE - 1; k >= 0; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk]);
    return w;
}

// The same, differentiated once ...
INLINE row_t tap_slopes(float t, int chunk)
{
#if DEGREE >= 1
    row_t w = filter_columns[DEGREE][chunk] * (float)DEGREE;
#pragma unroll
    for (int k = DEGREE - 1; k >= 1; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk] * (float)k);
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// ... and twice.
INLINE row_t tap_bends(float t, int chunk)
{
#if DEGREE >= 2
    row_t w = filter_columns[DEGREE][chunk] * (float)(DEGREE * (DEGREE - 1));
#pragma unroll
    for (int k = DEGREE - 1; k >= 2; --k)
        w = madd(w, (row_t)(t), filter_columns[k][chunk] * (float)(k * (k - 1)));
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// The sum of a row, by halves: one order of additions on every device.
INLINE float row_sum(row_t v)
{
#if ROW == 1
    return v;
#elif ROW == 2
    return v.s0 + v.s1;
#else
#if ROW == 8
    float4 q = v.lo + v.hi;
#else
    float4 q = v;
#endif
    float2 p = q.lo + q.hi;
    return p.x + p.y;
#endif
}

#define WEIGHTS (CHUNKS * ROW)

// All taps one by one, and their derivatives.
#define UNPACK(name, of)                                     \
    INLINE void name(float t, float w[WEIGHTS])              \
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
