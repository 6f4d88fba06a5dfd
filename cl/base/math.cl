// Vectorized roots, powers and logarithms of LANES numbers.

#include "base/lanes.cl"

#if LANES == 1
#define square_root sqrt
#else
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

// 1 / square_root(x) within 3e-7, for x from 1e-37 to 1e37. A root and a division take most of the time of a normal; processors have
// an estimate of twelve bits, which one step of Newton's method doubles.
#if LANES > 1 && defined(__clang__) && defined(__AVX__)
INLINE float8 inverse_root_8(float8 x)
{
    const float8 estimate = __builtin_ia32_rsqrtps256(x);
    return estimate * (1.5f - 0.5f * x * estimate * estimate);
}
#if LANES == 16
INLINE real inverse_root(real x) { return (real)(inverse_root_8(x.lo), inverse_root_8(x.hi)); }
#else
#define inverse_root inverse_root_8
#endif
#else
INLINE real inverse_root(real x) { return 1.0f / square_root(x); }
#endif

// Built-in functions take at most eight numbers at a time.
#if LANES == 16
INLINE real round_down(real x) { return (real)(floor(x.lo), floor(x.hi)); }
#else
INLINE real round_down(real x) { return floor(x); }
#endif

// Logarithm and power to the base 2 within 3e-7, without a call: for x > 0, normal, and |y| small. Polynomials by
// Estrin's scheme: the latency of dependent operations dominates the cost of a sample.
// log_2_of takes x - 1 separately, for the lanes where it is given (and x is nearly 1): x lacks its digits.
INLINE real log_2_of(real x, mask given, real less)
{
    union { real f; mask i; } bits, part;
    bits.f = x;
    mask exponent = (bits.i >> 23) - 127;
    part.i = (bits.i & 0x7fffff) | 0x3f800000;   // 1 <= part < 2
    const mask upper = part.f > 1.41421356f;
    part.f = choose(upper, 0.5f * part.f, part.f);
    const real whole = choose(upper, to_real(exponent + 1), to_real(exponent));
    const real y = choose(given, less, part.f - 1.0f), y2 = y * y, y4 = y2 * y2;
    const real low = madd(y2, madd(y, (real)(-0.36024198f), 0.48092404f), madd(y, (real)(-0.72135276f), 1.4426949f));
    const real high = madd(y2, madd(y, (real)(-0.14620353f), 0.23420985f), madd(y, (real)(-0.24882181f), 0.28707561f));
    return madd(y, madd(y4, high, low), whole);
}

INLINE real log_2(real x) { return log_2_of(x, NONE, x); }

INLINE real exp_2(real y)
{
    y = MIN(MAX(y, (real)(-60.0f)), (real)(60.0f));   // no result is subnormal, which would be slow
    const mask whole = to_mask(y + choose(y < 0.0f, (real)(-0.5f), (real)(0.5f)));   // rounds to nearest: conversion truncates
    const real f = y - to_real(whole);
    const real f2 = f * f, f4 = f2 * f2;             // exp(f ln 2), |f| <= 1/2
    const real low = madd(f2, madd(f, (real)(5.5504109e-2f), 0.24022651f), madd(f, (real)(0.69314718f), 1.0f));
    const real high = madd(f2, madd(f, (real)(1.5252734e-5f), 1.5403530e-4f), madd(f, (real)(1.3333558e-3f), 9.6181291e-3f));
    const real p = madd(f4, high, low);
    union { real f; mask i; } scale;
    scale.i = (whole + 127) << 23;
    return p * scale.f;
}

// 1 - exp_2(y) for y <= 0, to full precision even where it is small: there `scale` is 1.
INLINE real one_less_exp_2(real y)
{
    y = MAX(y, (real)(-60.0f));
    const mask whole = to_mask(y - 0.5f);   // the nearest
    const real f = y - to_real(whole);
    const real f2 = f * f;
    const real low = madd(f, (real)(0.24022651f), 0.69314718f), middle = madd(f, (real)(9.6181291e-3f), 5.5504109e-2f);
    const real high = madd(f, (real)(1.5403530e-4f), 1.3333558e-3f);
    const real less = f * madd(f2, madd(f2, high, middle), low);   // exp_2(f) - 1
    union { real f; mask i; } scale;
    scale.i = (whole + 127) << 23;
    return (1.0f - scale.f) - scale.f * less;
}

// x > 0 to a power, given whether that is a whole number. `floor` is the x whose power is invisibly small.
INLINE real power(real x, float exponent, int whole, float floor)
{
    x = MAX(x, (real)(floor));
    if (!whole)
        return exp_2(exponent * log_2(x));
    real result = (real)(1.0f);
    for (int e = whole; e > 0; e >>= 1, x *= x)
        result = e & 1 ? result * x : result;
    return result;
}
