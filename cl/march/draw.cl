// Kernel: a picture, from the first sample of its rays to their colours, in one launch. The fast path.

#include "march/march.cl"
#include "march/picture.cl"

#if CAST

// Sends rays to the lights from where those of a tile await light, and shades what they met. Returns whether some of these go on.
INLINE int light_tile(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax,
                      global const ulong2 *sides, constant frame_t *frame, global const float4 *table,
                      global const float2 *places MISSING_TOO)
{
    cast_t *cast = tile->cast;
    if (!begin_light_rays(tile, coefficients, extent, frame, table))
        return 0;
    tile_t toward;
    toward.cast = cast;
    for (toward.light = 0; toward.light < frame->lights.directed; ++toward.light) {
        begin_tile(&toward, frame, tile->left, tile->top, places);
        march_parts(&toward, coefficients, extent, minmax, sides, frame, table, places AND_MISSING);
        for (int g = 0; g < PACKETS; ++g)
            cast->left[g][toward.light] = LIGHT_BEHIND(toward.states + g);
    }
    return pass_lit(tile, coefficients, extent, frame, table);
}

#endif

kernel void draw(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                 global const uchar *missing, constant frame_t *frame, global const float4 *table, global const float2 *places,
                 global float4 *rgba, global float *depth, global float *normals, global float *positions, global float *visited, global float *values)
{
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;
    if (left >= frame->picture.width || top >= frame->picture.height)
        return;
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    tile_t tile;
#if CAST
    cast_t cast;
    tile.cast = &cast;
    tile.light = -1;
    for (int g = 0; g < PACKETS; ++g)
        cast.on[g] = ~NONE;
#endif
    begin_tile(&tile, frame, left, top, places);
    march_parts(&tile, coefficients, extent, minmax, sides, frame, table, places AND_MISSING);
#if CAST
    while (light_tile(&tile, coefficients, extent, minmax, sides, frame, table, places AND_MISSING))
        march_parts(&tile, coefficients, extent, minmax, sides, frame, table, places AND_MISSING);
#endif
    finish_tile(&tile, coefficients, extent, frame, table, &pictures);
}
