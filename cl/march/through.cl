// Light through the slots of a packet (slots.cl), once all media have added their samples. Set before: what "composite" defines.

#include "march/slots.cl"

// Samples number `from` to before `from + count` of a ray in this state; returns the lanes that need more.
INLINE mask go_through(state_t *state, const slots_t *slots, constant frame_t *frame, const ray_t *ray, const float from, const int count,
                       mask open)
{
    for (int n = 0; n < count && any_lane(open); ++n) {
        if (!(slots->touched[n * slots->tiles] & slots->bit))
            continue;
        SLOTS const real *sum = slots->sums + n * slots->apart;
        const real through = sum[3];
        const mask seen = open & (through < 0.0f);
        const real per = 1.0f / choose(seen, through, (real)(1.0f));
        const color_t color = { per * sum[0], per * sum[1], per * sum[2], (real)(0.0f), (real)(0.0f) };
        absorb(state, color, through, madd(from + (n - 0.5f), ray->step, ray->first), ray->step, seen);
        open = open & !finished(state, frame);
    }
    return open;
}

// The colours of rays that have passed all slots.
INLINE void store_mixed(const tile_t *tile, constant frame_t *frame, const pictures_t *pictures)
{
    const real3 unknown = real3_of((real)(NAN), (real)(NAN), (real)(NAN));   // normals: of which medium?
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(tile->left, g), y = PACKET_Y(tile->top, g);
        if (x < frame->picture.width && y < frame->picture.height) {
            const color_t color = mixed_color(tile->states + g);
            const real t = place_of(tile->states + g);
            store_packet(frame, tile->rays + g, color, t, unknown, places_at(frame, tile->rays + g, t), (real)(NAN),
                         tile->gathered[g], x, y, pictures);
        }
    }
}
