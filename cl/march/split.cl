// Kernels: the same picture in parts. Stretches of the rays are marched apart, merged, and finished last.
//
// States lie in a buffer as planes of pixels: STATE_FIELDS numbers of the mode, and how many samples were gathered.

#include "march/march.cl"
#include "march/picture.cl"

typedef union { state_t state; lanes_u fields[STATE_FIELDS]; } state_u;
typedef char state_has_its_fields[sizeof(state_t) == STATE_FIELDS * sizeof(real) ? 1 : -1];

#define STATE_AT(field) states[((size_t)(field) * frame->picture.height + y + i / LANES_ACROSS) * frame->picture.width + x + i % LANES_ACROSS]

INLINE void store_states(const tile_t *tile, constant frame_t *frame, global float *states)
{
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(tile->left, g), y = PACKET_Y(tile->top, g);
        const state_u state = { tile->states[g] };
        const lanes_u gathered = { tile->gathered[g] };
        EACH_PIXEL(x, y) {
            for (int field = 0; field < STATE_FIELDS; ++field)
                STATE_AT(field) = state.fields[field].each[i];
            STATE_AT(STATE_FIELDS) = gathered.each[i];
        }
    }
}

INLINE void load_states(tile_t *tile, constant frame_t *frame, global const float *states)
{
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(tile->left, g), y = PACKET_Y(tile->top, g);
        state_u state = { tile->states[g] };
        lanes_u gathered = { tile->gathered[g] };
        EACH_PIXEL(x, y) {
            for (int field = 0; field < STATE_FIELDS; ++field)
                state.fields[field].each[i] = STATE_AT(field);
            gathered.each[i] = STATE_AT(STATE_FIELDS);
        }
        tile->states[g] = state.state;
        tile->gathered[g] = gathered.all;
    }
}

#define TILE_OF_THIS_ITEM                                                                                           \
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;                  \
    if (left >= frame->picture.width || top >= frame->picture.height)                                               \
        return;                                                                                                     \
    tile_t tile;                                                                                                    \
    begin_tile(&tile, frame, left, top, 0)

// Samples number `from` to `to` of every ray, and REACH before, from the beginning or, if `carried`, from the states given.
kernel void march_rays(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                       constant frame_t *frame, global const float4 *table, const float from, const float to, const int carried,
                       global float *states)
{
    TILE_OF_THIS_ITEM;
    if (carried) {
        load_states(&tile, frame, states);
        for (int g = 0; g < PACKETS; ++g)
            tile.going[g] = tile.going[g] & !finished(tile.states + g, frame);
    }
    tile.first = MAX(tile.first, carried ? from : from - REACH);
    tile.last = MIN(tile.last, to);
    march_tile(&tile, coefficients, extent, minmax, sides, frame, table);
    store_states(&tile, frame, states);
}

// `back` is behind `states`, into which it goes.
kernel void merge_states(constant frame_t *frame, global float *states, global const float *back)
{
    TILE_OF_THIS_ITEM;
    tile_t behind = tile;
    load_states(&tile, frame, states);
    load_states(&behind, frame, back);
    for (int g = 0; g < PACKETS; ++g) {
        merge(tile.states + g, behind.states + g);
        tile.gathered[g] += behind.gathered[g];
    }
    store_states(&tile, frame, states);
}

kernel void finish_states(COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table,
                          global const float *states, global float4 *rgba, global float *depth, global float *normals,
                          global float *positions, global float *visited)
{
    const pictures_t pictures = { rgba, depth, normals, positions, visited };
    TILE_OF_THIS_ITEM;
    load_states(&tile, frame, states);
    finish_tile(&tile, coefficients, extent, frame, table, &pictures);
}
