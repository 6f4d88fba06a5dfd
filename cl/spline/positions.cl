// LANES positions at once: see position.cl.

// Positions along an axis: of lanes 0 to 3, and of lanes 4 to 7. (Of doubles, eight are wider than most registers.)
#if COORD_DOUBLE
typedef double4 coord4;
typedef long4 mask4;
typedef long mask_each;
#else
typedef float4 coord4;
typedef int4 mask4;
typedef int mask_each;
#endif
typedef struct { coord4 low, high; } coords_t;

#if COORD_DOUBLE
#define COORDS(v) CONVERT(v, double4)
#else
#define COORDS(v) CONVERT(v, float4)
#endif

INLINE coords_t to_coords(mask i)
{
    const coords_t c = { COORDS(i.lo), COORDS(i.hi) };
    return c;
}

typedef struct { coords_t x, y, z; } group_t;

// Up to LANES points from the n-th, and the last one again.
INLINE group_t group_of(source_t source, int n, int count)
{
    group_t p;
#if ON_GRID
    p.x = to_coords(source.i + n + (mask)(0, 1, 2, 3, 4, 5, 6, 7));
    p.y = to_coords((mask)(source.j));
    p.z = to_coords((mask)(source.k));
#else
    typedef PASTE(POINT, 4) point4;
    typedef point4 point4_at __attribute__((aligned(4)));
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
    p.y.low = ALONG(1, 0); p.y.high = ALONG(1, 4);
#if DIMENSIONS == 3
    p.z.low = ALONG(2, 0); p.z.high = ALONG(2, 4);
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
#undef COMPONENT
#endif
    return p;
}

// One row of the transform: see index_of.
INLINE coords_t group_row(group_t p, constant coord *m, coord offset)
{
    coords_t c;
#if DIMENSIONS == 3
    c.low = madd(m[0], p.x.low, madd(m[1], p.y.low, madd(m[2], p.z.low, offset)));
    c.high = madd(m[0], p.x.high, madd(m[1], p.y.high, madd(m[2], p.z.high, offset)));
#else
    c.low = madd(m[0], p.x.low, madd(m[1], p.y.low, offset));
    c.high = madd(m[0], p.x.high, madd(m[1], p.y.high, offset));
#endif
    return c;
}

INLINE group_t group_index(group_t p, constant coord *m)
{
    group_t at;
    at.x = group_row(p, m, m[9]);
    at.y = group_row(p, m + 3, m[10]);
#if DIMENSIONS == 3
    at.z = group_row(p, m + 6, m[11]);
#else
    at.z = to_coords(NONE);
#endif
    return at;
}
