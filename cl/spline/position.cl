// The source of points, the destination of their results, and their positions in the volume.
//
// Set by the host: ON_GRID, whether points are on a grid instead of read; POINT, the type of points that are read, and POINT_BITS,
// its size; PLANAR, whether all coordinates along an axis are contiguous, the last axis (x) last; SORTED, whether each point is
// followed by its place in the original list (sort.cl); INDICES, whether positions are already indices; CHAIN, whether transforms
// map the points first (chain.cl).

#include "base/platform.cl"

#if CHAIN
#include "spline/chain.cl"
#else
#define CHAIN_ARGUMENTS
#define CHAIN_GIVEN
#endif

#if ON_GRID
// (i, j, k), and those that follow along i
typedef struct {
    int i, j, k;
    size_t first;
#if CHAIN
    chain_t chain;
#endif
} source_t;
INLINE size_t place_of(source_t source, int n) { return source.first + n; }
#else
// planes: how far apart axes lie, if PLANAR
typedef struct { global const POINT *points; size_t first, planes; } source_t;
#if SORTED
#define STRIDE 4
#else
#define STRIDE DIMENSIONS
#endif

// A whole number stored as a coordinate.
#if POINT_BITS == 64
#define PLACE_IN(w) as_ulong(w)
#define AS_PLACE(i) as_double((ulong)(i))
#else
#define PLACE_IN(w) as_uint(w)
#define AS_PLACE(i) as_float((uint)(i))
#endif

INLINE size_t place_of(source_t source, int n)
{
#if SORTED
    return PLACE_IN(source.points[STRIDE * (source.first + n) + 3]);
#else
    return source.first + n;
#endif
}
#endif

typedef struct { coord x, y, z; } position_t;

INLINE position_t given_point(source_t source, int n)
{
#if ON_GRID
    const position_t p = { source.i + n, source.j, source.k };
#else
#if PLANAR && !SORTED
    global const POINT *point = source.points + source.first + n + (DIMENSIONS - 1) * source.planes;
#define ALONG(axis) point[-(axis) * (long)source.planes]
#else
    global const POINT *point = source.points + STRIDE * (source.first + n);
#define ALONG(axis) point[axis]
#endif
    position_t p = { ALONG(0), 0, 0 };
#if DIMENSIONS >= 2
    p.y = ALONG(1);
#endif
#if DIMENSIONS == 3
    p.z = ALONG(2);
#endif
#undef ALONG
#endif
    return p;
}

INLINE position_t point_of(source_t source, int n)
{
    position_t p = given_point(source, n);
#if CHAIN
#if DIMENSIONS == 3
    const place_t place = through_chain(source.chain, (place_t)(p.x, p.y, p.z, 0));
    p.z = place.z;
#else
    const place_t place = through_chain(source.chain, (place_t)(p.x, p.y));
#endif
    p.x = place.x;
    p.y = place.y;
#endif
    return p;
}

// transform: 9 entries of a matrix, row by row, then 3 of an offset: index = matrix position + offset,
// from world positions, or from the grid's own indices; then 9 of world_to_index; then 0.
// The order of additions, and that each product is rounded, are those of scipy.ndimage: on which side of a jump a position lies
// depends on them. PoCL's compiler rounds once, whatever FP_CONTRACT says, unless something it does not know stands in between:
// that last 0.
#define LAST_OF_TRANSFORM 21
#if COORD_DOUBLE
#define ROUNDED(product, zero) as_double(as_long(product) ^ as_long(zero))
#else
#define ROUNDED(product, zero) as_float(as_int(product) ^ as_int(zero))
#endif

INLINE coord index_along(position_t p, constant coord *m, const coord offset, const coord zero)
{
    return ((offset + ROUNDED(m[2] * p.z, zero)) + ROUNDED(m[1] * p.y, zero)) + ROUNDED(m[0] * p.x, zero);
}

INLINE position_t index_of(position_t p, constant coord *m)
{
#if INDICES
    return p;
#else
    const coord zero = m[LAST_OF_TRANSFORM];
    const position_t at = { index_along(p, m, m[9], zero), index_along(p, m + 3, m[10], zero), index_along(p, m + 6, m[11], zero) };
    return at;
#endif
}
