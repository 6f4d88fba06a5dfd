// Kernels: the same picture in parts. Stretches of the rays are marched separately, merged, and finished last.

#include "march/march.cl"
#include "march/picture.cl"
#include "march/states.cl"

// Samples number `from` to `to` of every ray, and REACH before (but where each crossing counts), from the beginning or, if `carried`,
// from the states given. The numbers of the second and further parts of rays count two more for each part before, whose ends have
// numbers of their own (MARGIN).
kernel void march_rays(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                       global const uchar *missing, constant frame_t *frame, global const float4 *table, const float from, const float to, const int carried,
                       global float *states)
{
    TILE_OF_THIS_ITEM(0);
    if (carried) {
        load_states(&tile, frame, states);
        for (int g = 0; g < PACKETS; ++g)
            tile.going[g] = tile.going[g] & !finished(tile.states + g, frame);
    }
    for (int part = -1; next_part_of(&tile, frame, 0, &part);) {
        const float first = from - 2.0f * part, last = to - 2.0f * part;
        enter_tile(&tile, coefficients, extent, frame, table, part, first, last AND_MISSING);
        tile.first = MAX(tile.first, carried | LAYERED ? first : first - REACH);
        tile.last = MIN(tile.last, last);
        march_tile(&tile, coefficients, extent, minmax, sides, frame, table AND_MISSING);
    }
    store_states(&tile, frame, states);
}

// `back` is behind `states`, into which it goes.
kernel void merge_states(constant frame_t *frame, global float *states, global const float *back)
{
    TILE_OF_THIS_ITEM(0);
    tile_t behind = tile;
    load_states(&tile, frame, states);
    load_states(&behind, frame, back);
    merge_tiles(&tile, &behind, frame);
    store_states(&tile, frame, states);
}

kernel void finish_states(COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table,
                          global const float *states, global float4 *rgba, global float *depth, global float *normals,
                          global float *positions, global float *visited, global float *values)
{
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    TILE_OF_THIS_ITEM(0);
    load_states(&tile, frame, states);
    finish_tile(&tile, coefficients, extent, frame, table, &pictures);
}
