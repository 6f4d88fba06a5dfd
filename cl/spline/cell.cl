// From a position in samples to its cell: the first tap's coefficient on each axis, and the fraction past it. The index rule is
// only here in the kernels, and only in Filter.cell on the host:
//
//     u = x * GRID_SCALE - LEFT,   base = floor(u),   t = u - base
//
// Set by the host: GRID_SCALE, coefficients per sample; LEFT = TAPS/2 - 1, exactly, as a floating constant.
//
// | for                                    | positions       | counted from               | rounding down |
// |----------------------------------------|-----------------|----------------------------|---------------|
// | locate, locate_axis                    | any             | the volume's first         | by comparing  |
// | locate_inner, locate_inner_axis        | in the domain   | the first stored           | by truncation, since nothing is negative |
// | locate_inner_lanes                     | LANES of these  | the first stored           | likewise      |
// | GRID_POSITION, then locate_lanes       | LANES in float  | any stored, and limited in between | likewise |

#include "base/coords.cl"

// The position of a point among the stored coefficients: the first tap, and the fraction past it.
typedef struct { int x, y, z; scalar tx, ty, tz; } cell_t;

// The position u, of any type, that counts from `origin` coefficients before the volume's first; see cell_origin.
#define GRID_POSITION(x, origin) ((x) * GRID_SCALE - (origin))

// For GRID_POSITION: counts from the coefficient that lies `before` the volume's first, for instance by the halo.
INLINE scalar cell_origin(int before) { return LEFT - (scalar)before; }

// The largest integer not above x, if it fits an int.
INLINE coord whole_below(coord x)
{
    const coord i = (coord)(int)x;
    return x < i ? i - 1 : i;
}

INLINE int locate_axis(coord x, scalar *t)
{
    const coord u = GRID_POSITION(x, (coord)LEFT), base = whole_below(u);
    *t = (scalar)(u - base);
    return (int)base;
}

INLINE cell_t locate(coord x, coord y, coord z, int halo)
{
    cell_t c;
    c.x = locate_axis(x, &c.tx) + halo;
#if DIMENSIONS >= 2
    c.y = locate_axis(y, &c.ty) + halo;
#else
    c.y = 0;
    c.ty = 0.0f;
#endif
#if DIMENSIONS == 3
    c.z = locate_axis(z, &c.tz) + halo;
#else
    c.z = 0;
    c.tz = 0.0f;
#endif
    return c;
}

// The same within the domain, where no stored coefficient that is needed has a negative index.
INLINE int locate_inner_axis(coord x, int halo, scalar *t)
{
#if TAPS == 1   // the function jumps where a rounded sum must not cross
    return locate_axis(x, t) + halo;
#else
    const coord u = GRID_POSITION(x, (coord)LEFT - (coord)halo);
    const int base = (int)u;
    *t = (scalar)(u - base);
    return base;
#endif
}

INLINE cell_t locate_inner(coord x, coord y, coord z, int halo)
{
    cell_t c;
    c.x = locate_inner_axis(x, halo, &c.tx);
#if DIMENSIONS >= 2
    c.y = locate_inner_axis(y, halo, &c.ty);
#else
    c.y = 0;
    c.ty = 0.0f;
#endif
#if DIMENSIONS == 3
    c.z = locate_inner_axis(z, halo, &c.tz);
#else
    c.z = 0;
    c.tz = 0.0f;
#endif
    return c;
}

// -- LANES positions -------------------------------------------------------------------------------------------

#if LANES == 8
INLINE mask locate_inner_lanes(coords_t x, int halo, real *t)
{
#if TAPS == 1
    const coord4 low = GRID_POSITION(x.low, (coord)LEFT), high = GRID_POSITION(x.high, (coord)LEFT);
    const mask base = (mask)(CONVERT(low, int4), CONVERT(high, int4));   // rounded towards zero
    const coords_t whole = to_coords(base);
    *t = (real)(0.0f);
    return base + (mask)(CONVERT(low < whole.low, int4), CONVERT(high < whole.high, int4)) + halo;
#else
    const coord origin = (coord)LEFT - (coord)halo;
    const coord4 low = GRID_POSITION(x.low, origin), high = GRID_POSITION(x.high, origin);
    const mask base = (mask)(CONVERT(low, int4), CONVERT(high, int4));
    const coords_t whole = to_coords(base);
    *t = (real)(CONVERT(low - whole.low, scalar4), CONVERT(high - whole.high, scalar4));
    return base;
#endif
}
#endif

// u: GRID_POSITIONs in float, not negative.
INLINE mask locate_lanes(real u, real *t)
{
    const mask base = to_mask(u);
    *t = u - to_real(base);
    return base;
}
