// Tap weights of the current filter and their derivatives: the only code that knows DEGREE.
//
// Set by the host from the filter's row (filters.py): TAPS, DEGREE, FILTER_COLUMNS: column k holds the
// coefficients of t^k of all taps, zero past TAPS; ROW, the vector width that covers them, or 8 if
// they are more, and CHUNKS, how many such vectors do. (PoCL 3.0 aborts on float16 for some processors.)

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)

#if ROW == 1
typedef float row_t;
#define LOAD_ROW(p) (*(p))
#define STORE_ROW(v, p) (*(p) = (v))
#else
typedef PASTE(float, ROW) row_t;
#define LOAD_ROW(p) PASTE(vload, ROW)(0, p)
#define STORE_ROW(v, p) PASTE(vstore, ROW)(v, 0, p)
#endif

constant float filter_columns[DEGREE + 1][CHUNKS * ROW] = FILTER_COLUMNS;

#define COLUMN(k, chunk) LOAD_ROW(filter_columns[k] + (chunk) * ROW)

// One chunk of the taps, by Horner's rule in the fractional position t.
inline row_t tap_weights(float t, int chunk)
{
    row_t w = COLUMN(DEGREE, chunk);
#pragma unroll
    for (int k = DEGREE - 1; k >= 0; --k)
        w = madd(w, (row_t)(t), COLUMN(k, chunk));
    return w;
}

// The same, differentiated once ...
inline row_t tap_slopes(float t, int chunk)
{
#if DEGREE >= 1
    row_t w = COLUMN(DEGREE, chunk) * (float)DEGREE;
#pragma unroll
    for (int k = DEGREE - 1; k >= 1; --k)
        w = madd(w, (row_t)(t), COLUMN(k, chunk) * (float)k);
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// ... and twice.
inline row_t tap_bends(float t, int chunk)
{
#if DEGREE >= 2
    row_t w = COLUMN(DEGREE, chunk) * (float)(DEGREE * (DEGREE - 1));
#pragma unroll
    for (int k = DEGREE - 1; k >= 2; --k)
        w = madd(w, (row_t)(t), COLUMN(k, chunk) * (float)(k * (k - 1)));
    return w;
#else
    return (row_t)(0.0f);
#endif
}

// The sum of a row, by halves: one order of additions on every device.
inline float row_sum(row_t v)
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
#define UNPACK(name, of)                                   \
    inline void name(float t, float w[WEIGHTS])            \
    {                                                      \
        _Pragma("unroll") for (int i = 0; i < CHUNKS; ++i) \
            STORE_ROW(of(t, i), w + i * ROW);              \
    }
UNPACK(unpack_weights, tap_weights)
UNPACK(unpack_slopes, tap_slopes)
UNPACK(unpack_bends, tap_bends)
