// Kernel: a picture, from the first sample of its rays to their colours, in one launch. The fast path.

#include "march/march.cl"
#include "march/picture.cl"

kernel void draw(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                 global const uchar *missing, constant frame_t *frame, global const float4 *table, global const float2 *places,
                 global float4 *rgba, global float *depth, global float *normals, global float *positions, global float *visited, global float *values)
{
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;
    if (left >= frame->picture.width || top >= frame->picture.height)
        return;
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    tile_t tile;
    begin_tile(&tile, frame, left, top, places);
    for (int part = -1; next_part_of(&tile, frame, places, &part);) {
        enter_tile(&tile, coefficients, extent, frame, table, part, -INFINITY, INFINITY AND_MISSING);
        march_tile(&tile, coefficients, extent, minmax, sides, frame, table AND_MISSING);
    }
    finish_tile(&tile, coefficients, extent, frame, table, &pictures);
}
