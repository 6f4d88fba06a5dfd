// Kernels: light through the media that have added their samples to a slab's (add.cl, slots.cl).

#include "march/march.cl"
#include "march/picture.cl"
#include "march/states.cl"
#include "march/through.cl"

// Before any samples. `going`: for each tile whether some of its rays meet any medium; `ends`: its first and last sample's number,
// and one more on both sides: for the face of a cut, and for a ray that leaves a medium before the next plane, alone in it.
kernel void begin_media(constant frame_t *frame, global const float2 *places, global float *states, global uchar *going,
                        global float2 *ends)
{
    TILE_OF_THIS_ITEM(places);
    store_states(&tile, frame, states);
    int some = 0;
    for (int g = 0; g < PACKETS; ++g)
        some |= any_lane(tile.going[g]);
    const int number = number_of_tile(frame, left, top);
    going[number] = some;
    ends[number] = some ? (float2)(tile.first - 1.0f, tile.last + 1.0f) : (float2)(INFINITY, -INFINITY);
}

// Samples number `from` to `to`: `count` of them. Leaves all untouched.
kernel void mix_media(constant frame_t *frame, global const float2 *places, const float from, const int count, global float *states,
                      global uchar *going, global float *sums, global uint *touched)
{
    if (!TILE_IS_GOING)
        return;
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    const size_t number = number_of_tile(frame, left, top), tiles = number_of_tiles(frame);
    int some = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const slots_t slots = slots_of(sums, touched, number, tiles, g, PACKETS, from);
        const ray_t *ray = tile.rays + g;
        const mask open = tile.going[g] & !finished(tile.states + g, frame);
        some |= any_lane(go_through(tile.states + g, &slots, frame, ray, from, count, open) & (ray->end + 1.0f >= from + count));
    }
    for (int n = 0; n < count; ++n)
        touched[n * tiles + number] = 0;
    store_states(&tile, frame, states);
    going[number] = some;
}

kernel void finish_media(constant frame_t *frame, global const float2 *places, global const float *states, global float4 *rgba,
                         global float *depth, global float *normals, global float *positions, global float *visited, global float *values)
{
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    TILE_OF_THIS_ITEM(places);
    load_states(&tile, frame, states);
    store_mixed(&tile, frame, &pictures);
}
