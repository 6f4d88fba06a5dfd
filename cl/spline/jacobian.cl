// Kernel: the Jacobian of a chain of transforms at the points of a grid: writes its determinants, or converts gradients, each after
// a value, from the moving to the fixed world, in place.
//
// Set by the host: PULL_BACK, whether to convert gradients; RUN, points of a work-item.

#include "base/platform.cl"
#include "spline/chain.cl"

// ends: the map from the grid to the world, and the linear maps by which the chain's derivative begins and ends.
// grid: the number of points along x and y, and the first row and slice of this launch.
kernel void jacobian_grid(constant place_t *ends, const int4 grid, global scalar *results CHAIN_ARGUMENTS)
{
    const chain_t chain = { chain_maps, chain_grids, chain_weights, chain_values, stages };
    const int j = (int)get_global_id(1) + grid.z, k = (int)get_global_id(2) + grid.w;
    const int begin = get_global_id(0) * RUN, end = MIN(begin + RUN, grid.x);
    if (j >= grid.y)
        return;
    for (int i = begin; i < end; ++i) {
        const size_t at = ((size_t)k * grid.y + j) * grid.x + i;
        place_t columns[DIMENSIONS];
        for (int n = 0; n < DIMENSIONS; ++n)
            columns[n] = ends[n];
#if DIMENSIONS == 3
        place_t p = (place_t)(i, j, k, 0);
#else
        place_t p = (place_t)(i, j);
#endif
        for (int n = 0; n < chain.stages; ++n)
            p = through_stage(chain, n, p, 1, columns);
        for (int n = 0; n < DIMENSIONS; ++n)
            columns[n] = turned(ends + MAP, columns[n]);
#if PULL_BACK
        global scalar *g = results + (1 + DIMENSIONS) * at + 1;
        coord sums[DIMENSIONS];
        for (int n = 0; n < DIMENSIONS; ++n) {
            sums[n] = columns[n].x * g[0] + columns[n].y * g[1];
#if DIMENSIONS == 3
            sums[n] += columns[n].z * g[2];
#endif
        }
        for (int n = 0; n < DIMENSIONS; ++n)
            g[n] = sums[n];
#else
        const place_t a = columns[0], b = columns[1];
#if DIMENSIONS == 3
        const place_t c = columns[2];
        results[at] = a.x * (b.y * c.z - b.z * c.y) - a.y * (b.x * c.z - b.z * c.x) + a.z * (b.x * c.y - b.y * c.x);
#else
        results[at] = a.x * b.y - a.y * b.x;
#endif
#endif
    }
}
