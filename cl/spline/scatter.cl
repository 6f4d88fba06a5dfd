// The adjoint of sampling: every point adds its value times the weights of its taps to their coefficients.
//
// The result is the same to the last bit on every run, without atomic additions. Coefficients lie in bricks at least as long
// as a row of taps, and points belong to the brick of their first tap, so that a brick's points only touch it and the next ones
// along each axis. Bricks of one colour (2^d of them, by the parity of their indices) share no coefficient: they are computed in
// parallel, one in each work-item, which takes its points in their original order.
//
// | kernel         | a work-item                                                                      |
// |----------------|----------------------------------------------------------------------------------|
// | locate_points  | a point: first tap, fractions, its contribution in units of samples; its brick's number |
// | scatter_points | a brick of one colour                                                            |
//
// Set by the host: DERIVATIVE, 0 or 1, of the sampling; POINT, the type of positions; BRICK, its length in coefficients; and
// what is included.

#include "base/platform.cl"
#include "spline/filter.cl"
#include "spline/boundary.cl"
#include "spline/cell.cl"
#include "spline/position.cl"

#if DIMENSIONS == 3
#define SLICES TAPS
#else
#define SLICES 1
#endif

#if DERIVATIVE == 0
#define COMPONENTS 1
#else
#define COMPONENTS DIMENSIONS
#endif

#define NO_BRICK UINT_MAX

// Coefficients on either side of the volume's: all taps of points in the domain, and of those that the boundary rule brings to
// just outside, where every tap is past the edge.
#define MARGIN (TAPS + 1)

// stored, bricks: coefficients along x, y and z, margins included; and bricks. m: as for points.cl.
kernel void locate_points(const int4 size, const int4 period, const int4 stored, const int4 bricks, constant coord *m,
                          global const POINT *points, global const scalar *values, const ulong count,
                          global ulong *places, global scalar *fractions, global scalar *added, global uint *brick_of)
{
    const size_t n = get_global_id(0);
    if (n >= count)
        return;
    values += COMPONENTS * n;
    const int sizes[3] = { size.x, size.y, size.z }, periods[3] = { period.x, period.y, period.z };
    const int limits[3] = { stored.x, stored.y, stored.z };
    const int across[3] = { bricks.x, bricks.y, bricks.z };
    const source_t source = { points, n, 0 };
    const position_t index = index_of(point_of(source, 0), m);
    const coord at[3] = { index.x, index.y, index.z };
    int outside = 0;
    for (int axis = 0; axis < DIMENSIONS; ++axis) {
        if (!(at[axis] - at[axis] == 0)) {   // no such position
            brick_of[n] = NO_BRICK;
            return;
        }
        outside |= at[axis] < (coord)-0.5 || at[axis] > sizes[axis] - (coord)0.5;
    }
    ulong place = 0, row = 1;
    uint brick = 0, bricks_before = 1;
    for (int axis = 0; axis < DIMENSIONS; ++axis) {
        int sign = 1;
        const coord x = outside ? boundary_position(at[axis], sizes[axis], periods[axis], &sign) : at[axis];
        scalar t;
        const int base = locate_axis(x, &t) + MARGIN;
        place += row * base;
        row *= limits[axis];
        brick += bricks_before * (base / BRICK);
        bricks_before *= across[axis];
        fractions[DIMENSIONS * n + axis] = t;
#if DERIVATIVE == 1
        scalar slope = 0;
        for (int i = 0; i < DIMENSIONS; ++i)
            slope += (scalar)m[12 + 3 * axis + i] * values[i];
        added[COMPONENTS * n + axis] = sign * slope;
#endif
    }
#if DERIVATIVE == 0
    added[n] = values[0];
#endif
    places[n] = place;
    brick_of[n] = brick;
}

// first: the place of this colour's first brick, 0 or 1 along x, y, z. Brick b's points are those from starts[b] on in `order`.
kernel void scatter_points(const int4 stored, const int4 bricks, const int4 first, global const ulong *places,
                           global const scalar *fractions, global const scalar *added, global const int *order,
                           global const int *starts, global scalar *coefficients)
{
    const int x = 2 * (int)get_global_id(0) + first.x, y = 2 * (int)get_global_id(1) + first.y;
    const int z = 2 * (int)get_global_id(2) + first.z;
    if (x >= bricks.x || y >= bricks.y || z >= bricks.z)
        return;
    const size_t brick = ((size_t)z * bricks.y + y) * bricks.x + x, row = stored.x, slice = row * stored.y;
    for (int next = starts[brick]; next < starts[brick + 1]; ++next) {
        const size_t n = order[next];
        global const scalar *t = fractions + DIMENSIONS * n, *value = added + COMPONENTS * n;
        global scalar *at = coefficients + places[n];
        scalar wx[WEIGHTS], wy[WEIGHTS], wz[WEIGHTS];
        unpack_weights(t[0], wx);
        unpack_weights(t[1], wy);
#if DIMENSIONS == 3
        unpack_weights(t[2], wz);
#else
        wz[0] = 1;
#endif
#if DERIVATIVE == 1
        scalar sx[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS];
        unpack_slopes(t[0], sx);
        unpack_slopes(t[1], sy);
#if DIMENSIONS == 3
        unpack_slopes(t[2], sz);
        const scalar up = value[2];
#else
        sz[0] = 0;
        const scalar up = 0;
#endif
#endif
        for (int k = 0; k < SLICES; ++k)
            for (int j = 0; j < TAPS; ++j) {
                global scalar *line = at + k * slice + j * row;
#if DERIVATIVE == 0
                const scalar w = value[0] * wz[k] * wy[j];
                for (int i = 0; i < TAPS; ++i)
                    line[i] += w * wx[i];
#else
                const scalar along = value[0] * wz[k] * wy[j], across = value[1] * wz[k] * sy[j] + up * sz[k] * wy[j];
                for (int i = 0; i < TAPS; ++i)
                    line[i] += along * sx[i] + across * wx[i];
#endif
            }
    }
}
