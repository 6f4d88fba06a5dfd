// Kernels: a picture of a volume whose bricks are resident one at a time (window.cl). Rays traverse the bricks front to back and
// carry their states on; results that need coefficients where a ray ends are computed while the brick is resident.
//
// States are in a buffer, as planes of pixels, as in split.cl; so are these results: the colour, if FINISHED_THERE, then the
// normal, if GUIDES.

#include "march/march.cl"
#include "march/picture.cl"
#include "march/states.cl"

#define SHOWN_NORMALS (FINISHED_THERE ? 3 : 0)   // the field at which they begin
#define SHOWN_FIELDS (SHOWN_NORMALS + (GUIDES ? 3 : 0))
#define SHOWN_AT(field) shown[KEPT_AT(field)]

// Before the first brick. `going`: for each tile whether some of its rays are unfinished.
kernel void begin_states(constant frame_t *frame, global const float2 *places, global float *states, global uchar *going)
{
    TILE_OF_THIS_ITEM(places);
    store_states(&tile, frame, states);
    int some = 0;
    for (int g = 0; g < PACKETS; ++g)
        some |= any_lane(tile.going[g]);
    going[number_of_tile(frame, left, top)] = some;
}

// Before a brick, for rays after other bricks: as `begin_states`, with given states.
kernel void resume_states(constant frame_t *frame, global const float2 *places, global const float *states, global uchar *going)
{
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    int some = 0;
    for (int g = 0; g < PACKETS; ++g)
        some |= any_lane(tile.going[g] & !finished(tile.states + g, frame));
    going[number_of_tile(frame, left, top)] = some;
}

// Rays that traversed bricks separately: merges `back`, which is behind, into `states`; results are those where rays end.
kernel void merge_bricks(constant frame_t *frame, global const float2 *places, global float *states, global float *shown,
                         global const float *back, global const float *shown_back)
{
    TILE_OF_THIS_ITEM(places);
    tile_t behind = tile;
    load_states(&tile, frame, states);
    load_states(&behind, frame, back);
    real before[PACKETS];
    for (int g = 0; g < PACKETS; ++g)
        before[g] = place_of(tile.states + g);
    merge_tiles(&tile, &behind, frame);
    store_states(&tile, frame, states);
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(left, g), y = PACKET_Y(top, g);
        const lane_masks_u elsewhere = { place_of(tile.states + g) != before[g] };
        EACH_PIXEL(x, y)
            if (elsewhere.each[i])
                for (int field = 0; field < SHOWN_FIELDS; ++field)
                    SHOWN_AT(field) = shown_back[KEPT_AT(field)];
    }
}

// Before the brick in the window is read: whether values from low to high there could change the result of any ray of these tiles.
kernel void ask_brick(constant frame_t *frame, global const float4 *table, global const float2 *places,
                      global const float *states, global const uchar *going, const float low, const float high, global int *wanted)
{
    if (!TILE_IS_GOING)
        return;
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    int some = 0;
    for (int g = 0; g < PACKETS && !some; ++g) {
        real enter, leave;
        stretch_in_window(frame, tile.rays + g, &enter, &leave);
        const mask inside = tile.going[g] & !finished(tile.states + g, frame) & (enter <= leave);
        some = any_lane(inside) && ((frame->clip.clipped && FACE_MATTERS(frame, low, high)) ||
                                    matters(tile.states + g, frame, table, low, high, enter, inside));
    }
    if (some)
        *wanted = 1;   // all writers write the same value
}

// The results of the rays of a packet that have just ended, as far as they are known.
INLINE void show(COEFFICIENTS coefficients, const sample_t *sample, const state_t *state, mask changed, const int x, const int y,
                 global float *shown)
{
    constant frame_t *frame = sample->frame;
    const lane_masks_u wanted = { changed };
#if FINISHED_THERE
    const color_t color = finish(state, coefficients, sample);
    const lanes_u red = { color.red }, green = { color.green }, blue = { color.blue };
    EACH_PIXEL(x, y)
        if (wanted.each[i]) {
            SHOWN_AT(0) = red.each[i];
            SHOWN_AT(1) = green.each[i];
            SHOWN_AT(2) = blue.each[i];
        }
#endif
    if (GUIDES && frame->picture.pass == 0) {
        const real3 normal = normals_at(coefficients, sample, state, place_of(state), changed);
        const lanes_u nx = { normal.x }, ny = { normal.y }, nz = { normal.z };
        EACH_PIXEL(x, y)
            if (wanted.each[i]) {
                SHOWN_AT(SHOWN_NORMALS) = nx.each[i];
                SHOWN_AT(SHOWN_NORMALS + 1) = ny.each[i];
                SHOWN_AT(SHOWN_NORMALS + 2) = nz.each[i];
            }
    }
}

// Marches rays through the brick in the window.
kernel void march_brick(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                        global const uchar *missing, constant frame_t *frame, global const float4 *table, global const float2 *places, global float *states,
                        global float *shown, global uchar *going)
{
    if (!TILE_IS_GOING)
        return;
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    real before[PACKETS];
    mask hits[PACKETS];
    for (int g = 0; g < PACKETS; ++g) {
        hits[g] = tile.going[g];
        tile.going[g] &= !finished(tile.states + g, frame);
        before[g] = place_of(tile.states + g);
    }
    global const float *whole = whole_pointer(coefficients, extent, frame);
    int met = 0;
    for (int part = -1; next_part_of(&tile, frame, places, &part);) {
        if (!enter_window(&tile, frame))
            continue;
        met = 1;
        enter_tile(&tile, whole, extent, frame, table, part, -INFINITY, INFINITY AND_MISSING);
        march_tile(&tile, whole, extent, minmax, sides, frame, table AND_MISSING);
    }
    if (!met)
        return;
    store_states(&tile, frame, states);
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    int some = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const real t = place_of(tile.states + g);
        const mask changed = hits[g] & (t < NOWHERE) & (t != before[g]);
        const sample_t sample = { frame, table, extent, tile.rays + g, &none, 0, 0.0f, 0 };
        if ((FINISHED_THERE || GUIDES) && any_lane(changed))
            show(whole, &sample, tile.states + g, changed, PACKET_X(left, g), PACKET_Y(top, g), shown);
        some |= any_lane(hits[g] & !finished(tile.states + g, frame));
    }
    going[number_of_tile(frame, left, top)] = some;
}

// After the last brick: the picture. No coefficients are resident.
kernel void finish_bricks(COEFFICIENTS nothing, const int4 extent, constant frame_t *frame, global const float4 *table,
                          global const float2 *places, global const float *states, global const float *shown, global float4 *rgba,
                          global float *depth, global float *normals, global float *positions, global float *visited, global float *values)
{
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    plane_t none;
    none.usable = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(left, g), y = PACKET_Y(top, g);
        if (x >= frame->picture.width || y >= frame->picture.height)
            continue;
        const ray_t *ray = tile.rays + g;
        const state_t *state = tile.states + g;
        const real t = place_of(state);
        const mask somewhere = t < NOWHERE;
        lanes_u nx = { (real)(NAN) }, ny = nx, nz = nx;
        const lane_masks_u known = { somewhere };
        const sample_t sample = { frame, table, extent, ray, &none, 0, 0.0f, 0 };
        (void)sample;   // not every mode uses it
#if FINISHED_THERE
        lanes_u red = { (real)(0.0f) }, green = red, blue = red;
        EACH_PIXEL(x, y)
            if (known.each[i]) {
                red.each[i] = SHOWN_AT(0);
                green.each[i] = SHOWN_AT(1);
                blue.each[i] = SHOWN_AT(2);
            }
        const color_t color = { red.all, green.all, blue.all, choose(somewhere, (real)(1.0f), (real)(0.0f)), (real)(0.0f) };
#else
        const color_t color = finish(state, nothing, &sample);
#endif
        if (GUIDES && frame->picture.pass == 0)
            EACH_PIXEL(x, y)
                if (known.each[i]) {
                    nx.each[i] = SHOWN_AT(SHOWN_NORMALS);
                    ny.each[i] = SHOWN_AT(SHOWN_NORMALS + 1);
                    nz.each[i] = SHOWN_AT(SHOWN_NORMALS + 2);
                }
        store_packet(frame, ray, color, t, real3_of(nx.all, ny.all, nz.all), places_at(frame, ray, t), VALUE_OF(state, &sample), tile.gathered[g], x,
                     y, &pictures);
    }
}
