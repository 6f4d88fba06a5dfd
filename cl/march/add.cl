// Kernel: one of several media adds its samples to a slab's (slots.cl); mix.cl then sends light through them.

#include "march/march.cl"
#include "march/picture.cl"
#include "march/states.cl"

// Samples number `from` to `to` of rays with these states, before all of them.
kernel void add_medium(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                       global const uchar *missing, constant frame_t *frame, global const float4 *table, global const float2 *places,
                       const float from, const float to, global const float *states, global const uchar *going, global float *sums,
                       global uint *touched)
{
    if (!TILE_IS_GOING)
        return;
    TILE_OF_THIS_ITEM(places);
    const size_t number = number_of_tile(frame, left, top), tiles = number_of_tiles(frame);
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(left, g), y = PACKET_Y(top, g);
        lanes_u opacity = { (real)(0.0f) }, rest = opacity;
        EACH_PIXEL(x, y) {
            opacity.each[i] = STATE_AT(OPACITY_FIELD);
            rest.each[i] = STATE_AT(OPACITY_FIELD + 1);
        }
        state_t *state = tile.states + g;
        light_left(state, opacity.all, rest.all);
        state->slots = slots_of(sums, touched, number, tiles, g, PACKETS, from);
        tile.going[g] &= !finished(state, frame);
    }
    for (int part = -1; next_part_of(&tile, frame, places, &part);) {
        enter_tile(&tile, coefficients, extent, frame, table, part, from + 1.0f, to + 1.0f AND_MISSING);   // faces have the number before
        tile.first = MAX(tile.first, from);
        tile.last = MIN(tile.last, to);
        march_tile(&tile, coefficients, extent, minmax, sides, frame, table AND_MISSING);
    }
}
