// Where points come from, where their results belong, and where in the volume they lie.
//
// Set by the host: ON_GRID, whether points are those of a grid and not read; POINT, the type of those that are read, and
// POINT_BITS, its size; SORTED, whether each of these is followed by its place in the list that it came from (sort.cl); CHAIN,
// whether transforms bring points to other places first (chain.cl).

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
typedef struct { global const POINT *points; size_t first; } source_t;
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
    global const POINT *point = source.points + STRIDE * (source.first + n);
#if DIMENSIONS == 3
    const position_t p = { point[0], point[1], point[2] };
#else
    const position_t p = { point[0], point[1], 0 };
#endif
#endif
    return p;
}

INLINE position_t point_of(source_t source, int n)
{
    const position_t p = given_point(source, n);
#if CHAIN
#if DIMENSIONS == 3
    const place_t place = through_chain(source.chain, (place_t)(p.x, p.y, p.z, 0));
    const position_t q = { place.x, place.y, place.z };
#else
    const place_t place = through_chain(source.chain, (place_t)(p.x, p.y));
    const position_t q = { place.x, place.y, 0 };
#endif
    return q;
#else
    return p;
#endif
}

// transform: 9 entries of a matrix, row by row, then 3 of an offset: index = matrix position + offset,
// from world positions, or from the grid's own indices; then 9 of world_to_index.
INLINE position_t index_of(position_t p, constant coord *m)
{
    const position_t at = { madd(m[0], p.x, madd(m[1], p.y, madd(m[2], p.z, m[9]))),
                            madd(m[3], p.x, madd(m[4], p.y, madd(m[5], p.z, m[10]))),
                            madd(m[6], p.x, madd(m[7], p.y, madd(m[8], p.z, m[11]))) };
    return at;
}
