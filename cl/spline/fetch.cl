// One coefficient, one row of taps, or one trilinear fetch, from a buffer or from an image.
//
// Coefficients are stored with a halo on every side, filled by the boundary rule (coefficients.cl), so that no sample in the
// volume's domain reads outside. Coordinates count from the first stored coefficient.
// extent = (row pitch, rows, slices, halo).
//
// Functions that read coefficients take (COEFFICIENTS coefficients, const int4 extent, ...): an image cannot be the member
// of a struct. Images hold only float.
//
// Set by the host: FETCH_IMAGE, whether coefficients are an image.

#include "spline/filter.cl"

#if FETCH_IMAGE

#define COEFFICIENTS read_only image3d_t

constant sampler_t texel_sampler = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_NEAREST;
constant sampler_t linear_sampler = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_LINEAR;

INLINE scalar fetch_one(COEFFICIENTS coefficients, const int4 extent, int x, int y, int z)
{
    return read_imagef(coefficients, texel_sampler, (int4)(x, y, z, 0)).x;
}

typedef int4 cursor_t;
INLINE cursor_t cursor_at(COEFFICIENTS coefficients, const int4 extent, int x, int y, int z) { return (int4)(x, y, z, 0); }

INLINE cursor_t next_slice(COEFFICIENTS coefficients, const int4 extent, cursor_t c) { return c + (int4)(0, 0, 1, 0); }

INLINE row_t fetch_row(COEFFICIENTS coefficients, const int4 extent, cursor_t c, int i, int j)
{
    row_u taps;
#pragma unroll
    for (int n = 0; n < ROW; ++n)
        taps.each[n] = fetch_one(coefficients, extent, c.x + i + n, c.y + j, c.z);
    return taps.row;
}

INLINE scalar fetch_linear(COEFFICIENTS coefficients, const int4 extent, scalar x, scalar y, scalar z)
{
    return read_imagef(coefficients, linear_sampler, (float4)(x + 0.5f, y + 0.5f, z + 0.5f, 0.0f)).x;
}

#else

#define COEFFICIENTS global const scalar *restrict

INLINE size_t offset_of(const int4 extent, int x, int y, int z)
{
    return ((size_t)z * extent.y + y) * extent.x + x;
}

INLINE scalar fetch_one(COEFFICIENTS coefficients, const int4 extent, int x, int y, int z)
{
    return coefficients[offset_of(extent, x, y, z)];
}

// The start of a block of taps, so that additions alone reach its rows.
typedef global const scalar *cursor_t;
INLINE cursor_t cursor_at(COEFFICIENTS coefficients, const int4 extent, int x, int y, int z)
{
    return coefficients + offset_of(extent, x, y, z);
}

INLINE cursor_t next_slice(COEFFICIENTS coefficients, const int4 extent, cursor_t c) { return c + (size_t)extent.x * extent.y; }

INLINE row_t fetch_row(COEFFICIENTS coefficients, const int4 extent, cursor_t c, int i, int j)
{
    return *(global const row_at_t *)(c + (j * (size_t)extent.x + i));
}

INLINE scalar fetch_linear(COEFFICIENTS coefficients, const int4 extent, scalar x, scalar y, scalar z)
{
    const scalar fx = (scalar)(int)x, fy = (scalar)(int)y, fz = (scalar)(int)z;   // never negative
    const scalar tx = x - fx, ty = y - fy;
    global const scalar *p = coefficients + offset_of(extent, (int)fx, (int)fy, (int)fz);
    global const scalar *q = DIMENSIONS >= 2 ? p + extent.x : p;
#define MIX(a, b, t) madd(t, (b) - (a), a)
#define MIX_PLANE MIX(MIX(p[0], p[1], tx), MIX(q[0], q[1], tx), ty)
    scalar plane = MIX_PLANE;
#if DIMENSIONS == 3
    p += (size_t)extent.x * extent.y;
    q = p + extent.x;
    const scalar above = MIX_PLANE;
    plane = MIX(plane, above, z - fz);
#endif
#undef MIX_PLANE
#undef MIX
    return plane;
}

#endif
