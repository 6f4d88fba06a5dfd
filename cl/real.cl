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

// Logarithm and power to the base 2 within 3e-7, without a call: for x > 0, normal, and |y| small.
INLINE real log_2(real x)
{
    union { real f; mask i; } bits, part;
    bits.f = x;
    mask exponent = (bits.i >> 23) - 127;
    part.i = (bits.i & 0x7fffff) | 0x3f800000;   // 1 <= part < 2
    const mask upper = part.f > 1.41421356f;
    part.f = choose(upper, 0.5f * part.f, part.f);
    const real whole = choose(upper, to_real(exponent + 1), to_real(exponent));
    const real s = (part.f - 1.0f) / (part.f + 1.0f), q = s * s;   // ln x = 2 (s + s^3/3 + s^5/5 + ...)
    const real series = madd(q, madd(q, madd(q, madd(q, (real)(0.32059889f), 0.41219858f), 0.57707802f), 0.96179669f), 2.88539008f);
    return madd(s, series, whole);
}

INLINE real exp_2(real y)
{
    y = least(greatest(y, (real)(-126.0f)), (real)(126.0f));
    const mask whole = to_mask(y + choose(y < 0.0f, (real)(-0.5f), (real)(0.5f)));   // the nearest: cut off is towards zero
    const real f = y - to_real(whole);
    real p = madd(f, (real)(1.5252734e-5f), 1.5403530e-4f);                          // exp(f ln 2), |f| <= 1/2
    p = madd(f, p, 1.3333558e-3f);
    p = madd(f, p, 9.6181291e-3f);
    p = madd(f, p, 5.5504109e-2f);
    p = madd(f, p, 0.24022651f);
    p = madd(f, p, 0.69314718f);
    p = madd(f, p, 1.0f);
    union { real f; mask i; } scale;
    scale.i = (whole + 127) << 23;
    return p * scale.f;
}

// The rays of a row as an array, and back.
typedef union { real all; float each[LANES]; } lanes_u;
typedef union { mask all; int each[LANES]; } lane_masks_u;

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
