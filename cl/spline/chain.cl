// A chain of transforms: from a point of the fixed world to one of the moving world, and its derivatives.
//
// A stage is an affine map followed by a displacement: a spline with vector coefficients on a grid, and 0 outside the grid's domain.
// The host joins affine maps, and merges the last one, which has no grid after it, into the transform from positions to indices.
// One kernel handles chains of any length and order: stages are rows of tables.
//
// Set by the host: CHAIN_TAPS, whose bit n is set if some grid's filter has n taps, from 2 to 6; DIMENSIONS.

#include "base/platform.cl"

// Positions and displacements: (x, y, z, unused) or (x, y), in the type of positions.
#if DIMENSIONS == 3
#define VECTOR 4
#else
#define VECTOR 2
#endif
#if COORD_DOUBLE
#define PLACE PASTE(double, VECTOR)
#else
#define PLACE PASTE(float, VECTOR)
#endif
typedef PLACE place_t;
typedef place_t place_at __attribute__((aligned(sizeof(coord))));

// maps: for each stage the affine map, the map from the world to the grid's coefficients, each by its columns and its offset, and
// the domain among the coefficients, from and to.
#define MAP (DIMENSIONS + 1)
#define STAGE (2 * MAP + 2)

// grids: for each stage the taps, the coefficients along x, y and z, and where they begin.
#define GRID 5

// weights: for each stage a row of polynomial coefficients for each tap, of ascending powers below `taps`.
#define MOST_TAPS 6

typedef struct {
    constant place_t *maps;
    constant long *grids;
    constant coord *weights;
    global const coord *values;   // a vector per coefficient, x fastest, plus one number
    int stages;
} chain_t;

#define CHAIN_ARGUMENTS \
    , constant place_t *chain_maps, constant long *chain_grids, constant coord *chain_weights, global const coord *chain_values, \
        const int stages
#define CHAIN_GIVEN , { chain_maps, chain_grids, chain_weights, chain_values, stages }

// The linear part of a map.
INLINE place_t turned(constant place_t *m, place_t p)
{
#if DIMENSIONS == 3
    return madd(m[0], p.x, madd(m[1], p.y, m[2] * p.z));
#else
    return madd(m[0], p.x, m[1] * p.y);
#endif
}

INLINE place_t moved(constant place_t *m, place_t p)
{
#if DIMENSIONS == 3
    return madd(m[0], p.x, madd(m[1], p.y, madd(m[2], p.z, m[3])));
#else
    return madd(m[0], p.x, madd(m[1], p.y, m[2]));
#endif
}

// A displacement at the fractions t past the first coefficient, and, if `slopes` is set, its derivatives along x, y and z of the
// grid: sums[1] and on. `taps` and `slopes` are literals.
INLINE void grid_sums(const int taps, const int slopes, constant coord *m, global const coord *first, const long row,
                      const long slice, const place_t t, place_t sums[MAP])
{
    place_t w[MOST_TAPS], s[MOST_TAPS];
#pragma unroll
    for (int i = 0; i < taps; ++i) {
        w[i] = m[i * taps + taps - 1];
        s[i] = 0;
#pragma unroll
        for (int k = taps - 2; k >= 0; --k) {
            if (slopes)
                s[i] = madd(s[i], t, w[i]);
            w[i] = madd(w[i], t, m[i * taps + k]);
        }
    }
#pragma unroll
    for (int i = 0; i < MAP; ++i)
        sums[i] = 0;
#pragma unroll
    for (int k = 0; k < (DIMENSIONS == 3 ? taps : 1); ++k) {
        place_t plane = 0, plane_x = 0, plane_y = 0;
#pragma unroll
        for (int j = 0; j < taps; ++j) {
            place_t line = 0, line_x = 0;
#pragma unroll
            for (int i = 0; i < taps; ++i) {
                const place_t c = *(global const place_at *)(first + k * slice + j * row + DIMENSIONS * i);
                line = madd(w[i].x, c, line);
                if (slopes)
                    line_x = madd(s[i].x, c, line_x);
            }
            plane = madd(w[j].y, line, plane);
            if (slopes) {
                plane_x = madd(w[j].y, line_x, plane_x);
                plane_y = madd(s[j].y, line, plane_y);
            }
        }
#if DIMENSIONS == 3
        sums[0] = madd(w[k].z, plane, sums[0]);
        if (slopes) {
            sums[1] = madd(w[k].z, plane_x, sums[1]);
            sums[2] = madd(w[k].z, plane_y, sums[2]);
            sums[3] = madd(s[k].z, plane, sums[3]);
        }
#else
        sums[0] = plane;
        sums[1] = plane_x;
        sums[2] = plane_y;
#endif
    }
}

// Maps a point by stage n. If `slopes` is set, the columns, derivatives of the point, become those of the result.
INLINE place_t through_stage(chain_t chain, int n, place_t p, const int slopes, place_t columns[DIMENSIONS])
{
    constant place_t *m = chain.maps + n * STAGE;
    constant long *grid = chain.grids + n * GRID;
    p = moved(m, p);
    if (slopes)
        for (int i = 0; i < DIMENSIONS; ++i)
            columns[i] = turned(m, columns[i]);
    m += MAP;
    const place_t u = moved(m, p), low = m[MAP], high = m[MAP + 1];
    int inside = u.x >= low.x && u.x <= high.x && u.y >= low.y && u.y <= high.y;   // NaN and infinities are not
#if DIMENSIONS == 3
    inside = inside && u.z >= low.z && u.z <= high.z;
#endif
    if (!inside)
        return p;
    const int taps = grid[0];
    // the domain may end where the next cell would begin, which lacks a coefficient
#define FIRST(axis, i) MIN((int)u.axis, (int)grid[i] - taps)
    const long x = FIRST(x, 1), y = FIRST(y, 2), row = DIMENSIONS * grid[1], slice = row * grid[2];
    global const coord *first = chain.values + grid[4] + y * row + x * DIMENSIONS;
#if DIMENSIONS == 3
    const long z = FIRST(z, 3);
    first += z * slice;
    const place_t t = (place_t)(u.x - x, u.y - y, u.z - z, 0);
#else
    const place_t t = (place_t)(u.x - x, u.y - y);
#endif
#undef FIRST
    constant coord *weights = chain.weights + n * MOST_TAPS * MOST_TAPS;
    place_t sums[MAP];
    switch (taps) {
#define CASE(number)                                                        \
    case number:                                                            \
        grid_sums(number, slopes, weights, first, row, slice, t, sums);     \
        break;
#if CHAIN_TAPS >> 2 & 1
        CASE(2)
#endif
#if CHAIN_TAPS >> 3 & 1
        CASE(3)
#endif
#if CHAIN_TAPS >> 4 & 1
        CASE(4)
#endif
#if CHAIN_TAPS >> 5 & 1
        CASE(5)
#endif
#if CHAIN_TAPS >> 6 & 1
        CASE(6)
#endif
#undef CASE
    default:
        return p;
    }
    if (slopes)
        for (int i = 0; i < DIMENSIONS; ++i) {
            const place_t along = turned(m, columns[i]);
            columns[i] = madd(sums[1], along.x, madd(sums[2], along.y, columns[i]));
#if DIMENSIONS == 3
            columns[i] = madd(sums[3], along.z, columns[i]);
#endif
        }
    return p + sums[0];
}

// Maps a point by the whole chain.
INLINE place_t through_chain(chain_t chain, place_t p)
{
    place_t none[DIMENSIONS];
    for (int n = 0; n < chain.stages; ++n)
        p = through_stage(chain, n, p, 0, none);
    return p;
}
