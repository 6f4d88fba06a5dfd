// Kernel: a picture of several media whose functions are of one kind, from the first sample of its rays to their colours, in one launch:
// as by mix.cl and add.cl, but a tile's slots are few enough to stay in the cache, and nobody adds what is hidden.
//
// Set by the host: MEDIA, how many, 2 to 8.

#define SLOTS   // private
#include "march/march.cl"
#include "march/picture.cl"
#include "march/through.cl"

#define AT_ONCE 64   // samples between two mixings

#define MEDIUM(k)                                                                                                      \
    COEFFICIENTS coefficients##k, const int4 extent##k, global const float2 *minmax##k, global const ulong2 *sides##k, \
    global const uchar *missing##k, constant frame_t *frame##k, global const float4 *table##k,
#if MEDIA == 2
#define EACH(of) of(0) of(1)
#elif MEDIA == 3
#define EACH(of) of(0) of(1) of(2)
#elif MEDIA == 4
#define EACH(of) of(0) of(1) of(2) of(3)
#elif MEDIA == 5
#define EACH(of) of(0) of(1) of(2) of(3) of(4)
#elif MEDIA == 6
#define EACH(of) of(0) of(1) of(2) of(3) of(4) of(5)
#elif MEDIA == 7
#define EACH(of) of(0) of(1) of(2) of(3) of(4) of(5) of(6)
#else
#define EACH(of) of(0) of(1) of(2) of(3) of(4) of(5) of(6) of(7)
#endif

typedef struct {
    tile_t tile;              // its rays
    mask going[PACKETS];      // those that meet it
    float first, last;
} medium_t;

kernel void draw_together(EACH(MEDIUM) constant frame_t *frame, global const float2 *places, global float4 *rgba, global float *depth,
                          global float *normals, global float *positions, global float *visited, global float *values)
{
    const int left = (int)get_global_id(0) * TILE_WIDTH, top = (int)get_global_id(1) * TILE_HEIGHT;
    if (left >= frame->picture.width || top >= frame->picture.height)
        return;
#define ITS(what, k) what##k,
#define COEFFICIENTS_OF(k) ITS(coefficients, k)
#define EXTENT_OF(k) ITS(extent, k)
#define MINMAX_OF(k) ITS(minmax, k)
#define SIDES_OF(k) ITS(sides, k)
#define MISSING_OF(k) ITS(missing, k)
#define FRAME_OF(k) ITS(frame, k)
#define TABLE_OF(k) ITS(table, k)
    COEFFICIENTS all_coefficients[MEDIA] = { EACH(COEFFICIENTS_OF) };
    const int4 extents[MEDIA] = { EACH(EXTENT_OF) };
    global const float2 *pyramids[MEDIA] = { EACH(MINMAX_OF) };
    global const ulong2 *all_sides[MEDIA] = { EACH(SIDES_OF) };
    global const uchar *gaps[MEDIA] = { EACH(MISSING_OF) };
    constant frame_t *frames[MEDIA] = { EACH(FRAME_OF) };
    global const float4 *tables[MEDIA] = { EACH(TABLE_OF) };

    real sums[AT_ONCE * PACKETS * SLOT];
    uint touched[AT_ONCE];
    tile_t mixed;
    medium_t media[MEDIA];
    begin_tile(&mixed, frame, left, top, places);
    for (int m = 0; m < MEDIA; ++m) {
        medium_t *medium = media + m;
        begin_tile(&medium->tile, frames[m], left, top, places);
        for (int g = 0; g < PACKETS; ++g)
            medium->going[g] = medium->tile.going[g];
        medium->first = medium->tile.first;
        medium->last = medium->tile.last;
    }
    for (int n = 0; n < AT_ONCE; ++n)
        touched[n] = 0;
    const lanes_u nothing[CARRIED] = { { (real)(0.0f) } };

    int some = 0;
    for (int g = 0; g < PACKETS; ++g)
        some |= any_lane(mixed.going[g]);
    // one more on both sides: for the face of a cut, and for a ray that leaves a medium before the next plane, alone in it
    for (float from = mixed.first - 1.0f; some && from <= mixed.last + 1.0f; from += AT_ONCE) {
        const float to = from + (AT_ONCE - 1);
        for (int m = 0; m < MEDIA; ++m) {
            tile_t *tile = &media[m].tile;
            constant frame_t *own = frames[m];
            global const uchar *missing = gaps[m];
            (void)missing;
            for (int g = 0; g < PACKETS; ++g) {
                set_light(tile->states + g, mixed.states[g].opacity, mixed.states[g].rest, nothing);
                tile->states[g].slots = slots_of(sums, touched, 0, 1, g, PACKETS, from);
                tile->going[g] = media[m].going[g] & !finished(tile->states + g, own);
            }
            tile->first = media[m].first;
            tile->last = media[m].last;
            for (int part = -1; next_part_of(tile, own, places, &part);) {
                enter_tile(tile, all_coefficients[m], extents[m], own, tables[m], part, from + 1.0f, to + 1.0f AND_MISSING);   // faces have the number before
                tile->first = MAX(tile->first, from);
                tile->last = MIN(tile->last, to);
                march_tile(tile, all_coefficients[m], extents[m], pyramids[m], all_sides[m], own, tables[m] AND_MISSING);
            }
        }
        some = 0;
        for (int g = 0; g < PACKETS; ++g) {
            const slots_t slots = slots_of(sums, touched, 0, 1, g, PACKETS, from);
            const ray_t *ray = mixed.rays + g;
            const mask open = mixed.going[g] & !finished(mixed.states + g, frame);
            some |= any_lane(go_through(mixed.states + g, &slots, frame, ray, from, AT_ONCE, open) & (ray->end + 1.0f >= to + 1.0f));
        }
        for (int n = 0; n < AT_ONCE; ++n)
            touched[n] = 0;
    }
    const pictures_t pictures = { rgba, depth, normals, positions, visited, values };
    store_mixed(&mixed, frame, &pictures);
}
