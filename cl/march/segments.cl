// Empty-space skipping: an iterator over the segments of a tile's rays in which some value could matter.
//
// A segment is a slab: samples with a few successive numbers, over all rays of the tile. The pyramid of minima and maxima
// (minmax.cl) is queried for the boxes of their positions, coarse segments first; segments in which no value matters are
// skipped. The picture is the same to the last bit, since skipping does not change how gathered samples are evaluated.
//
// Set by the host: BLOCK, cells along an edge of the finest blocks. Set before: PACKETS, and what the mode defines.

#include "base/lanes.cl"
#include "base/vector.cl"
#include "spline/cell.cl"
#include "march/camera.cl"
#include "march/window.cl"

#define MAX_LOOKS 32    // maximum number of blocks read for a box
#define COARSEST 4      // 1 << COARSEST slabs are skipped at once at most
#define MAX_PARTS 32    // of a ray, where samples may come in any order
#ifndef SLOPES_MATTER   // a mode's: whether slopes could change a result, where `matters` does not say no
#define SLOPES 0
#define SLOPES_MATTER(frame, table, bounds) 1
#endif
#define MARGIN ((real)(ENDPOINTS ? 1.0f : 0.0f))   // sample numbers before and after the planes, for the two ends of a ray

// -- the values in a box of positions --------------------------------------------------------------------------

typedef struct { real3 low, high; } boxes_t;   // a box for every lane

INLINE boxes_t empty_boxes(void)
{
    const boxes_t box = { { NOWHERE, NOWHERE, NOWHERE }, { -NOWHERE, -NOWHERE, -NOWHERE } };
    return box;
}

// Extends the boxes of the active lanes by samples number `first` to `last`.
INLINE void extend_boxes(boxes_t *box, const ray_t *ray, float first, float last, mask active)
{
    // a sample lies where the ray is inside, whatever its number would give
    const real a = MIN(MAX(madd(first, ray->step, ray->first), ray->enter), ray->leave);
    const real b = MIN(MAX(madd(last, ray->step, ray->first), ray->enter), ray->leave);
    const real3 p = at3(ray->origin, ray->direction, a), q = at3(ray->origin, ray->direction, b);
#define EXTEND(axis)                                                                            \
    box->low.axis = choose(active, MIN(box->low.axis, MIN(p.axis, q.axis)), box->low.axis);     \
    box->high.axis = choose(active, MAX(box->high.axis, MAX(p.axis, q.axis)), box->high.axis)
    EXTEND(x); EXTEND(y); EXTEND(z);
#undef EXTEND
}

// The block of a position's first tap, on an axis of `blocks` of them.
INLINE int block_of(float x, int halo, int origin, int blocks)
{
    const float cell = GRID_POSITION(x, cell_origin(halo)) - (float)origin, last = (float)(blocks * BLOCK - 1);
    return (int)(cell > 0.0f ? MIN(cell, last) : 0.0f) / BLOCK;   // infinite where no lane is active
}

// The smallest and the largest value in the lanes' boxes. The margin covers rounding errors of positions.
INLINE float2 values_in(global const float2 *minmax, constant frame_t *frame, const int halo, const boxes_t *box)
{
    constant minmax_block *block = &frame->minmax;
    const float m = block->margin;
    int nx = block->blocks[0], ny = block->blocks[1], nz = block->blocks[2];
    const int x_ = BLOCKS_FROM(frame, 0), y_ = BLOCKS_FROM(frame, 1), z_ = BLOCKS_FROM(frame, 2);
    int x0 = block_of(min_lane(box->low.x) - m, halo, x_, nx), x1 = block_of(max_lane(box->high.x) + m, halo, x_, nx);
    int y0 = block_of(min_lane(box->low.y) - m, halo, y_, ny), y1 = block_of(max_lane(box->high.y) + m, halo, y_, ny);
    int z0 = block_of(min_lane(box->low.z) - m, halo, z_, nz), z1 = block_of(max_lane(box->high.z) + m, halo, z_, nz);
    int level = 0;
    while (level < block->levels - 1 && (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1) > MAX_LOOKS) {
        x0 >>= 1; x1 >>= 1; y0 >>= 1; y1 >>= 1; z0 >>= 1; z1 >>= 1;
        nx = (nx + 1) >> 1; ny = (ny + 1) >> 1;
        ++level;
    }
    global const float2 *at = minmax + block->level_at[level];
    float low = INFINITY, high = -INFINITY;
    for (int z = z0; z <= z1; ++z)
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) {
                const float2 b = at[((size_t)z * ny + y) * nx + x];
                low = MIN(b.x, low);
                high = MAX(b.y, high);
            }
    return (float2)(low, high);
}

// -- the rays of a tile ----------------------------------------------------------------------------------------

// PACKETS times LANES rays, their states, and which are unfinished.
typedef struct {
    ray_t rays[PACKETS];
    state_t states[PACKETS];
    real gathered[PACKETS];   // samples
    mask going[PACKETS];
    float first, last;        // numbers of the first and the last sample of any ray
    int left, top;            // the pixel of the first ray
    int planar;               // whether all rays cross the planes, and in one direction ...
    float way;                // ... which is up (1) or down (-1) the axis
#if CAST
    struct cast_s *cast;      // what is left of lights where rays meet surfaces
    int light;                // number of the light that rays go to from there, or -1: they go through pixels
#endif
} tile_t;

// The lanes of a packet that have samples among the numbers from first to last.
INLINE mask lanes_within(const ray_t *ray, mask going, float first, float last)
{
    return going & (ray->begin - MARGIN <= last) & (ray->end + MARGIN >= first);
}

// Of some samples the smallest and the largest value, and magnitudes of gradients, if a mode asks for them.
typedef struct { float2 values, slopes; } bounds_t;

// Those among samples first to last of some packets.
INLINE bounds_t bounds_of(global const float2 *minmax, constant frame_t *frame, const int halo, const tile_t *tile, int packet,
                          const int packets, float first, float last)
{
    boxes_t box = empty_boxes();
    for (int g = packet; g < packet + packets; ++g)
        extend_boxes(&box, tile->rays + g, first - REACH, last + REACH, lanes_within(tile->rays + g, tile->going[g], first, last));
    bounds_t bounds = { values_in(minmax, frame, halo, &box), (float2)(0.0f, INFINITY) };
#if SLOPES
    if (frame->minmax.slopes_at)
        bounds.slopes = values_in(minmax + frame->minmax.slopes_at, frame, halo, &box) * frame->minmax.slope_scale;
#endif
    return bounds;
}

// Whether any sample among first to last of a packet, of these bounds, could matter to it.
INLINE int packet_matters(constant frame_t *frame, global const float4 *table, const tile_t *tile, int g, const bounds_t *bounds,
                          float first, float last)
{
    const ray_t *ray = tile->rays + g;
    return matters(tile->states + g, frame, table, bounds->values.x, bounds->values.y, madd(first, ray->step, ray->first),
                   lanes_within(ray, tile->going[g], first, last)) &&
           SLOPES_MATTER(frame, table, bounds);
}

// -- the iterator ----------------------------------------------------------------------------------------------

typedef struct {
    float start, stop;          // numbers of the segment's first and last sample
    int slab, until;            // the next slab, and where the part ends
    int slabs, level, deep;     // how many there are; 1 << level are tried at once; a part has 1 << deep
    int parts;
    float promise[MAX_PARTS];   // maximum per part
} segments_t;

// If the order is free, the most promising part is first, and only once.
INLINE int next_part(segments_t *s)
{
    int part = 0;
    for (int i = 1; i < s->parts; ++i)
        part = s->promise[i] > s->promise[part] ? i : part;
    if (s->promise[part] == -INFINITY)
        return 0;   // no ray has samples in the remaining ones
    s->promise[part] = -INFINITY;
    s->slab = part << s->deep;
    s->until = part + 1 < s->parts ? (part + 1) << s->deep : s->slabs;
    s->level = MIN(s->deep, COARSEST);
    return 1;
}

INLINE segments_t segments_of(const tile_t *tile, global const float2 *minmax, constant frame_t *frame, const int halo)
{
    segments_t s;
    const float slab = frame->planes.slab;
    s.slabs = tile->last >= tile->first ? (int)((tile->last - tile->first) / slab) + 1 : 0;
    s.deep = 30;
    s.parts = 1;
    s.slab = s.until = 0;
    s.promise[0] = 0.0f;
    if (ANY_ORDER && frame->minmax.skipping) {
        for (s.deep = 0; s.slabs >> s.deep >= MAX_PARTS; ++s.deep)
            ;
        for (s.parts = 0; s.parts << s.deep < s.slabs; ++s.parts) {
            const float start = madd(s.parts << s.deep, slab, tile->first), stop = madd(1 << s.deep, slab, start - 1.0f);
            const bounds_t bounds = bounds_of(minmax, frame, halo, tile, 0, PACKETS, start, stop);
            (void)bounds;   // not every mode uses them in PROMISE
            s.promise[s.parts] = PROMISE(bounds.values.x, bounds.values.y);
        }
    }
    return s;
}

// Advances to the next segment in which a value could matter to some ray; false at the end.
INLINE int next_segment(segments_t *s, const tile_t *tile, global const float2 *minmax, constant frame_t *frame,
                        global const float4 *table, const int halo)
{
    const float slab = frame->planes.slab;
    const int skipping = frame->minmax.skipping;
    for (;;) {
        if (s->slab >= s->until && !next_part(s))
            return 0;
        const float start = madd(s->slab, slab, tile->first), ahead = madd(1 << s->level, slab, start - 1.0f);
        const float stop = MIN(ahead, tile->last);
        int some = 0, wanted = !skipping;
        for (int g = 0; g < PACKETS; ++g)
            some |= any_lane(tile->going[g] & (tile->rays[g].end + MARGIN >= start));
        if (!some) {
            s->slab = s->until;
            continue;
        }
        if (skipping) {
            const bounds_t bounds = bounds_of(minmax, frame, halo, tile, 0, PACKETS, start, stop);
            for (int g = 0; g < PACKETS && !wanted; ++g)
                wanted = packet_matters(frame, table, tile, g, &bounds, start, stop);
        }
        if (!wanted) {
            s->slab += 1 << s->level;
            while (s->level < COARSEST && s->level < s->deep && (s->slab & (1 << s->level)) == 0)
                ++s->level;
        } else if (s->level > 0) {
            --s->level;
        } else {
            s->start = start;
            s->stop = stop;
            ++s->slab;
            return 1;
        }
    }
}
