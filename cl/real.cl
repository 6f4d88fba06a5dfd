// Modes are written once, for one ray or for a row of LANES rays: `real` is float or a vector of them.

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
    int4 four = m.lo | m.hi;
    int2 two = four.lo | four.hi;
    return two.x | two.y;
}
#ifdef __clang__
INLINE real to_real(mask i) { return __builtin_convertvector(i, real); }
INLINE mask to_mask(real x) { return __builtin_convertvector(x, mask); }
#else
INLINE real to_real(mask i) { return PASTE(convert_float, LANES)(i); }
INLINE mask to_mask(real x) { return PASTE(convert_int, LANES)(x); }
#endif
INLINE real square_root(real x)
{
#ifdef __clang__
    union { real all; float each[LANES]; } u;
    u.all = x;
    for (int i = 0; i < LANES; ++i)
        u.each[i] = __builtin_sqrtf(u.each[i]);
    return u.all;
#else
    return sqrt(x);
#endif
}
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

// The rays of a row as an array, and back.
typedef union { real all; float each[LANES]; } lanes_u;
typedef union { mask all; int each[LANES]; } lane_masks_u;

#if LANES > 1
// Lanes i and i + 4 share a vector of two rows of four, so that nothing leaves its half of a register on the way.
#define FOURTHS(row, i) (real)(row(i), row(i + 4))

// From rows[i], those of lanes i and i + 4, to four vectors of all lanes.
INLINE void transpose_fourths(const real rows[4], real lanes[4])
{
#define WEAVE(a, b, i, j, k, l) (real)((a).i, (b).i, (a).j, (b).j, (a).k, (b).k, (a).l, (b).l)
    const real a = WEAVE(rows[0], rows[1], s0, s1, s4, s5), b = WEAVE(rows[2], rows[3], s0, s1, s4, s5);
    const real c = WEAVE(rows[0], rows[1], s2, s3, s6, s7), d = WEAVE(rows[2], rows[3], s2, s3, s6, s7);
#undef WEAVE
    lanes[0] = (real)(a.s01, b.s01, a.s45, b.s45);
    lanes[1] = (real)(a.s23, b.s23, a.s67, b.s67);
    lanes[2] = (real)(c.s01, d.s01, c.s45, d.s45);
    lanes[3] = (real)(c.s23, d.s23, c.s67, d.s67);
}
#endif

#if LANES == 1
#define LANE_NUMBERS 0.0f
#else
#define LANE_NUMBERS (real)(0, 1, 2, 3, 4, 5, 6, 7)
#endif

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
