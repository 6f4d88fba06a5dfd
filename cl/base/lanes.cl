// Written once, for one ray or point, or for LANES of them at a time: `real` is float or a vector of them.

#if LANES == 1
typedef float real;
typedef int mask;
INLINE int any_lane(mask m) { return m; }
INLINE real to_real(mask i) { return (float)i; }
INLINE mask to_mask(real x) { return (int)x; }
#define square_root sqrt
#else
typedef PASTE(float, LANES) real;
typedef PASTE(int, LANES) mask;
INLINE int any_lane(mask m)
{
#if LANES == 16
    const int8 eight = m.lo | m.hi;
#else
    const int8 eight = m;
#endif
    int4 four = eight.lo | eight.hi;
    int2 two = four.lo | four.hi;
    return two.x | two.y;
}
INLINE real to_real(mask i) { return CONVERT(i, PASTE(float, LANES)); }
INLINE mask to_mask(real x) { return CONVERT(x, PASTE(int, LANES)); }
INLINE float8 square_root_8(float8 x)
{
#ifdef __clang__
    union { float8 all; float each[8]; } u;
    u.all = x;
    for (int i = 0; i < 8; ++i)
        u.each[i] = __builtin_sqrtf(u.each[i]);
    return u.all;
#else
    return sqrt(x);
#endif
}
#if LANES == 16
INLINE real square_root(real x) { return (real)(square_root_8(x.lo), square_root_8(x.hi)); }
#else
#define square_root square_root_8
#endif
#endif

// Of what is built in, by eights at most.
#if LANES == 16
INLINE real round_down(real x) { return (real)(floor(x.lo), floor(x.hi)); }
#else
INLINE real round_down(real x) { return floor(x); }
#endif

INLINE real choose(mask m, real yes, real no) { return m ? yes : no; }
INLINE real least(real a, real b) { return a < b ? a : b; }
INLINE real greatest(real a, real b) { return a > b ? a : b; }
INLINE real magnitude(real a) { return a < 0.0f ? -a : a; }

// Logarithm and power to the base 2 within 3e-7, without a call: for x > 0, normal, and |y| small. Polynomials by
// Estrin's scheme: what a sample costs is how long its operations wait for each other.
INLINE real log_2(real x)
{
    union { real f; mask i; } bits, part;
    bits.f = x;
    mask exponent = (bits.i >> 23) - 127;
    part.i = (bits.i & 0x7fffff) | 0x3f800000;   // 1 <= part < 2
    const mask upper = part.f > 1.41421356f;
    part.f = choose(upper, 0.5f * part.f, part.f);
    const real whole = choose(upper, to_real(exponent + 1), to_real(exponent));
    const real y = part.f - 1.0f, y2 = y * y, y4 = y2 * y2;
    const real low = madd(y2, madd(y, (real)(-0.36024198f), 0.48092404f), madd(y, (real)(-0.72135276f), 1.4426949f));
    const real high = madd(y2, madd(y, (real)(-0.14620353f), 0.23420985f), madd(y, (real)(-0.24882181f), 0.28707561f));
    return madd(y, madd(y4, high, low), whole);
}

INLINE real exp_2(real y)
{
    y = least(greatest(y, (real)(-60.0f)), (real)(60.0f));   // no result is so small that processors slow down
    const mask whole = to_mask(y + choose(y < 0.0f, (real)(-0.5f), (real)(0.5f)));   // the nearest: cut off is towards zero
    const real f = y - to_real(whole);
    const real f2 = f * f, f4 = f2 * f2;             // exp(f ln 2), |f| <= 1/2
    const real low = madd(f2, madd(f, (real)(5.5504109e-2f), 0.24022651f), madd(f, (real)(0.69314718f), 1.0f));
    const real high = madd(f2, madd(f, (real)(1.5252734e-5f), 1.5403530e-4f), madd(f, (real)(1.3333558e-3f), 9.6181291e-3f));
    const real p = madd(f4, high, low);
    union { real f; mask i; } scale;
    scale.i = (whole + 127) << 23;
    return p * scale.f;
}

// x > 0 to a power, given whether that is a whole number. `floor` is x whose power is nothing that anyone sees.
INLINE real power(real x, float exponent, int whole, float floor)
{
    x = greatest(x, (real)(floor));
    if (!whole)
        return exp_2(exponent * log_2(x));
    real result = (real)(1.0f);
    for (int e = whole; e > 0; e >>= 1, x *= x)
        result = e & 1 ? result * x : result;
    return result;
}

// The rays of a group as an array, and back.
typedef union { real all; float each[LANES]; } lanes_u;
typedef union { mask all; int each[LANES]; } lane_masks_u;
// Indices, never negative: as unsigned ones they take no instruction to become addresses.
typedef union { mask all; uint each[LANES]; } lane_indices_u;

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

// From rows[i], those of lanes i, i + 4, ..., to four vectors of all lanes.
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

// The rays of a group lie side by side, sixteen in two rows of eight.
#if LANES == 1
#define LANES_ACROSS 1
#define LANE_X 0.0f
#define LANE_Y 0.0f
#elif LANES == 8
#define LANES_ACROSS 8
#define LANE_X (real)(0, 1, 2, 3, 4, 5, 6, 7)
#define LANE_Y (real)(0.0f)
#else
#define LANES_ACROSS 8
#define LANE_X (real)(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)
#define LANE_Y (real)(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1)
#endif
#define LANES_DOWN (LANES / LANES_ACROSS)

#define NONE ((mask)(0))
#define NOWHERE ((real)(INFINITY))

typedef struct { real x, y, z; } real3;

INLINE real3 real3_of(real x, real y, real z) { real3 v = { x, y, z }; return v; }
INLINE real dot3(real3 a, real3 b) { return madd(a.x, b.x, madd(a.y, b.y, a.z * b.z)); }
INLINE real3 add3(real3 a, real3 b) { return real3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
INLINE real3 scale3(real3 a, real s) { return real3_of(a.x * s, a.y * s, a.z * s); }
INLINE real3 at3(real3 origin, real3 direction, real t)
{
    return real3_of(madd(t, direction.x, origin.x), madd(t, direction.y, origin.y), madd(t, direction.z, origin.z));
}

// A row-major 3 x 3 matrix times a vector, and its transpose times one.
INLINE real3 matrix3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[1], v.y, m[2] * v.z)), madd(m[3], v.x, madd(m[4], v.y, m[5] * v.z)),
                    madd(m[6], v.x, madd(m[7], v.y, m[8] * v.z)));
}
INLINE real3 transpose3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[3], v.y, m[6] * v.z)), madd(m[1], v.x, madd(m[4], v.y, m[7] * v.z)),
                    madd(m[2], v.x, madd(m[5], v.y, m[8] * v.z)));
}
