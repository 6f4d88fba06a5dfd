// Kernel: maps the points of a block of a grid by the stages of a chain of transforms.

#include "base/platform.cl"
#include "spline/chain.cl"

// size, corner: of the block, in points of the grid along x, y and z.
kernel void chain_places(const int4 size, const int4 corner, global coord *places CHAIN_ARGUMENTS)
{
    const chain_t chain = { chain_maps, chain_grids, chain_weights, chain_values, stages };
    const int i = (int)get_global_id(0), j = (int)get_global_id(1), k = (int)get_global_id(2);
    place_t unused[DIMENSIONS];
    place_t p = (place_t)(i + corner.x, j + corner.y, k + corner.z, 0);
    for (int n = 0; n < chain.stages; ++n)
        p = through_stage(chain, n, p, 0, unused);
    global coord *own = places + 3 * (((size_t)k * size.y + j) * size.x + i);
    own[0] = p.x;
    own[1] = p.y;
    own[2] = p.z;
}
