// The slots in which media add up their samples: for each sample number of a slab, and for each packet, colours times logarithms of
// transmittance, and these. A packet's first sample is stored, so that slots need not be cleared; `touched`, with a bit for each
// packet of a tile, says whether there was one.

#include "base/lanes.cl"
#include "transfer/ramp.cl"

#ifndef SLOTS
#define SLOTS global   // where they are
#endif
#define SLOT 4   // numbers of each ray
#define OPACITY_FIELD 3   // of the states that mix.cl keeps, which are those of composite.cl; followed by the rest
#define CARRIED 3   // numbers of a mode that go from brick to brick with its rays: where the first is 0, the others are not known
#define OPAQUE ((real)(-1e9f))   // of opaque matter: finite, so that its colour has a weight

typedef struct {
    SLOTS real *sums;       // of this packet for sample number `from` ...
    size_t apart;            // ... and how far apart those of successive numbers are
    SLOTS uint *touched;    // of this tile, likewise
    size_t tiles;
    uint bit;
    float from;
} slots_t;

INLINE slots_t slots_of(SLOTS void *sums, SLOTS uint *touched, const size_t tile, const size_t tiles, const int packet,
                        const int packets, const float from)
{
    const slots_t slots = {
        (SLOTS real *)sums + (tile * packets + packet) * SLOT, tiles * packets * SLOT, touched + tile, tiles, 1u << packet, from
    };
    return slots;
}

INLINE void add_sample(const slots_t *slots, const float number, const color_t color, const real through, const mask seen)
{
    const size_t n = (size_t)(number - slots->from);
    SLOTS real *sums = slots->sums + n * slots->apart;
    SLOTS uint *touched = slots->touched + n * slots->tiles;
    const real none = (real)(0.0f);
    const real light = choose(seen, MAX(through, OPAQUE), none);
    const real red = choose(seen, color.red * light, none), green = choose(seen, color.green * light, none);
    const real blue = choose(seen, color.blue * light, none);
    if (*touched & slots->bit) {
        sums[0] += red;
        sums[1] += green;
        sums[2] += blue;
        sums[3] += light;
    } else {
        *touched |= slots->bit;
        sums[0] = red;
        sums[1] = green;
        sums[2] = blue;
        sums[3] = light;
    }
}

// The same where lanes have numbers of their own.
INLINE void add_each(const slots_t *slots, const real number, const color_t color, const real through, const mask seen)
{
    const float last = max_lane(choose(seen, number, -NOWHERE));
    for (float n = min_lane(choose(seen, number, NOWHERE)); n <= last; n += 1.0f)
        add_sample(slots, n, color, through, seen & (number == n));
}
