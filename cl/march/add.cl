// Kernels: one of several media adds its samples to a slab's (slots.cl); mix.cl then sends light through them. Of a medium that is
// read by bricks those in the window are added.

#include "march/march.cl"
#include "march/picture.cl"
#include "march/states.cl"

#if WINDOWED
#define CARRIED_STATES global float *states   // a copy of those of mix.cl, with which rays go on from brick to brick, front to back
#else
#define CARRIED_STATES global const float *states
#endif

// Samples number `from` to `to` of rays with these states, before all of them.
kernel void add_medium(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                       global const uchar *missing, constant frame_t *frame, global const float4 *table, global const float2 *places,
                       const float from, const float to, CARRIED_STATES, global const uchar *going, global float *sums,
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
        set_light(state, opacity.all, rest.all);
#if WINDOWED && CARRIED
        real carried[CARRIED];
        for (int field = 0; field < CARRIED; ++field) {
            lanes_u each = { (real)(0.0f) };
            EACH_PIXEL(x, y)
                each.each[i] = STATE_AT(field);
            carried[field] = each.all;
        }
        set_carried(state, carried);
#endif
        state->slots = slots_of(sums, touched, number, tiles, g, PACKETS, from);
        tile.going[g] &= !finished(state, frame);
    }
    for (int part = -1; next_part_of(&tile, frame, places, &part);) {
#if WINDOWED
        if (!enter_window(&tile, frame))
            continue;
#endif
        // faces have the number before the first sample's on a plane
        enter_tile(&tile, whole_pointer(coefficients, extent, frame), extent, frame, table, part, from + !ENDPOINTS,
                   to + !ENDPOINTS AND_MISSING);
        tile.first = MAX(tile.first, LAYERED ? from : from - REACH);
        tile.last = MIN(tile.last, to);
        march_tile(&tile, whole_pointer(coefficients, extent, frame), extent, minmax, sides, frame, table AND_MISSING);
    }
#if WINDOWED
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(left, g), y = PACKET_Y(top, g);
        lanes_u opacity, rest;
        light_of(tile.states + g, &opacity.all, &rest.all);
        EACH_PIXEL(x, y) {
            STATE_AT(OPACITY_FIELD) = opacity.each[i];
            STATE_AT(OPACITY_FIELD + 1) = rest.each[i];
        }
#if CARRIED
        real carried[CARRIED];
        carried_of(tile.states + g, carried);
        for (int field = 0; field < CARRIED; ++field) {
            const lanes_u each = { carried[field] };
            EACH_PIXEL(x, y)
                STATE_AT(field) = each.each[i];
        }
#endif
    }
#endif
}

#if WINDOWED

// Before bricks are read: for each tile the numbers of the first and the last sample that its rays may have in the window.
kernel void span_of_brick(constant frame_t *frame, global const float2 *places, global const uchar *going, global float2 *span)
{
    if (!TILE_IS_GOING)
        return;
    TILE_OF_THIS_ITEM(places);
    const int some = enter_window(&tile, frame);   // faces have the number before
    span[number_of_tile(frame, left, top)] = some ? (float2)(tile.first - 2.0f, tile.last + 2.0f) : (float2)(INFINITY, -INFINITY);
}

#endif
