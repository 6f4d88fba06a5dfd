// LANES positions at once: see position.cl.

#include "base/coords.cl"
#include "spline/position.cl"

typedef struct { coords_t x, y, z; } positions_t;

// LANES points from the n-th. If `count`, what is left, is less, the last one is repeated.
INLINE positions_t points_of(source_t source, int n, int count)
{
    positions_t p;
#if CHAIN
    union { coords_t all; coord each[LANES]; } x, y, z;
    for (int i = 0; i < LANES; ++i) {
        const position_t one = point_of(source, n + MIN(i, count - 1));
        x.each[i] = one.x;
        y.each[i] = one.y;
        z.each[i] = one.z;
    }
    p.x = x.all;
    p.y = y.all;
    p.z = z.all;
#elif ON_GRID
    p.x = to_coords(source.i + n + (mask)(0, 1, 2, 3, 4, 5, 6, 7));
    p.y = to_coords((mask)(source.j));
    p.z = to_coords((mask)(source.k));
#else
    typedef PASTE(POINT, 4) point4;
    typedef point4 point4_at AT_ANY_ADDRESS;
#if PLANAR && !SORTED
    global const POINT *points = source.points + source.first + n + (DIMENSIONS - 1) * source.planes;
    union { point4 four[2]; POINT each[LANES]; } u;
#define ALONG(coords)                                                  \
    if (count >= LANES) {                                              \
        u.four[0] = *(global const point4_at *)points;                 \
        u.four[1] = *(global const point4_at *)(points + 4);           \
    } else {                                                           \
        for (int i = 0; i < LANES; ++i)                                \
            u.each[i] = points[MIN(i, count - 1)];                     \
    }                                                                  \
    coords.low = COORDS(u.four[0]), coords.high = COORDS(u.four[1]);   \
    points -= source.planes;
    ALONG(p.x)
#if DIMENSIONS >= 2
    ALONG(p.y)
#else
    p.y = to_coords(NONE);
#endif
#if DIMENSIONS == 3
    ALONG(p.z)
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
#else
    union { point4 four[LANES / 4 * STRIDE]; POINT each[LANES * STRIDE]; } u;
    global const POINT *points = source.points + STRIDE * (source.first + n);
    if (count >= LANES) {
#pragma unroll
        for (int i = 0; i < LANES / 4 * STRIDE; ++i)
            u.four[i] = *(global const point4_at *)(points + 4 * i);
    } else {
#pragma unroll
        for (int i = 0; i < LANES * STRIDE; ++i)
            u.each[i] = points[STRIDE * MIN(i / STRIDE, count - 1) + i % STRIDE];
    }
#define COMPONENT(i, axis) u.each[STRIDE * (i) + axis]
#define ALONG(axis, i) \
    COORDS(((point4)(COMPONENT(i, axis), COMPONENT(i + 1, axis), COMPONENT(i + 2, axis), COMPONENT(i + 3, axis))))
    p.x.low = ALONG(0, 0); p.x.high = ALONG(0, 4);
#if DIMENSIONS >= 2
    p.y.low = ALONG(1, 0); p.y.high = ALONG(1, 4);
#else
    p.y = to_coords(NONE);
#endif
#if DIMENSIONS == 3
    p.z.low = ALONG(2, 0); p.z.high = ALONG(2, 4);
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
#undef COMPONENT
#endif
#endif
    return p;
}

#if COORD_DOUBLE
#define ROUNDED_4(product, zero) as_double4(as_long4(product) ^ as_long(zero))
#else
#define ROUNDED_4(product, zero) as_float4(as_int4(product) ^ as_int(zero))
#endif

// One row of the transform, as index_along.
INLINE coords_t index_row(positions_t p, constant coord *m, const coord offset, const coord zero)
{
    coords_t c = { (coord4)(offset), (coord4)(offset) };
#if DIMENSIONS == 3
    c.low += ROUNDED_4(m[2] * p.z.low, zero);
    c.high += ROUNDED_4(m[2] * p.z.high, zero);
#endif
#if DIMENSIONS >= 2
    c.low += ROUNDED_4(m[1] * p.y.low, zero);
    c.high += ROUNDED_4(m[1] * p.y.high, zero);
#endif
    c.low += ROUNDED_4(m[0] * p.x.low, zero);
    c.high += ROUNDED_4(m[0] * p.x.high, zero);
    return c;
}

INLINE positions_t indices_of(positions_t p, constant coord *m)
{
#if INDICES
    return p;
#else
    const coord zero = m[LAST_OF_TRANSFORM];
    positions_t at;
    at.x = index_row(p, m, m[9], zero);
#if DIMENSIONS >= 2
    at.y = index_row(p, m + 3, m[10], zero);
#else
    at.y = to_coords(NONE);
#endif
#if DIMENSIONS == 3
    at.z = index_row(p, m + 6, m[11], zero);
#else
    at.z = to_coords(NONE);
#endif
    return at;
#endif
}
