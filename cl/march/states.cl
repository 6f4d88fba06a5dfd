// The states of rays in a buffer, as planes of pixels: STATE_FIELDS numbers of the mode, and the number of gathered samples; of all
// pixels, or of an area of whole tiles (kept).

#include "march/march.cl"
#include "march/picture.cl"

// The index of a field's number for pixel i of a packet that begins at (x, y).
#define KEPT_AT(field)                                                                                              \
    (((size_t)(field) * frame->picture.kept[1] + y - frame->picture.kept_from[1] + i / LANES_ACROSS) * frame->picture.kept[0] + \
     x - frame->picture.kept_from[0] + i % LANES_ACROSS)
#define STATE_AT(field) states[KEPT_AT(field)]

#if !ADDED

typedef union { state_t state; lanes_u fields[STATE_FIELDS]; } state_u;
typedef char state_has_its_fields[sizeof(state_t) == STATE_FIELDS * sizeof(real) ? 1 : -1];

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

// Merges `behind`, a stretch of the same rays, into `tile`, except for rays that have ended.
INLINE void merge_tiles(tile_t *tile, const tile_t *behind, constant frame_t *frame)
{
    for (int g = 0; g < PACKETS; ++g) {
        const mask open = ~NONE & !finished(tile->states + g, frame);
        const state_u front = { tile->states[g] };
        state_u both = front;
        merge(&both.state, behind->states + g);
        for (int field = 0; field < STATE_FIELDS; ++field)
            both.fields[field].all = choose(open, both.fields[field].all, front.fields[field].all);
        tile->states[g] = both.state;
        tile->gathered[g] += choose(open, behind->gathered[g], (real)(0.0f));
    }
}

#endif

// The tile of this work-item, before its first sample; its rays cross the picture at `places`, if that is listed.
#define TILE_OF_THIS_ITEM(places)                                                                                   \
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;                  \
    if (left >= frame->picture.width || top >= frame->picture.height)                                               \
        return;                                                                                                     \
    tile_t tile;                                                                                                    \
    begin_tile(&tile, frame, left, top, places)

// The index of the tile whose first pixel is (left, top), among those stored.
INLINE int number_of_tile(constant frame_t *frame, const int left, const int top)
{
    const int across = (frame->picture.kept[0] + TILE_WIDTH - 1) / TILE_WIDTH;
    return (top - frame->picture.kept_from[1]) / TILE_HEIGHT * across + (left - frame->picture.kept_from[0]) / TILE_WIDTH;
}

INLINE int number_of_tiles(constant frame_t *frame)
{
    return (frame->picture.kept[0] + TILE_WIDTH - 1) / TILE_WIDTH * ((frame->picture.kept[1] + TILE_HEIGHT - 1) / TILE_HEIGHT);
}

// Whether rays of this work-item's tile are unfinished: areas are boxes of tiles, and starting a tile's rays takes long.
#define TILE_IS_GOING                                                                                                   \
    ((int)get_global_id(0) * TILE_WIDTH < frame->picture.width && (int)get_global_id(1) * TILE_HEIGHT < frame->picture.height && \
     going[number_of_tile(frame, (int)get_global_id(0) * TILE_WIDTH, (int)get_global_id(1) * TILE_HEIGHT)])
