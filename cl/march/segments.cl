// Where the function cannot matter: the hierarchy of bounds (bounds.cl) asked for boxes of positions.
//
// Set by the host: BLOCK, cells along an edge of the finest blocks.

typedef struct { real3 low, high; } boxes_t;   // a box for every lane

// The box of samples number `first` to `last` of the active lanes; of the others, nothing.
INLINE void box_samples(const ray_t *ray, float first, float last, mask active, boxes_t *box)
{
    // a sample lies where the ray is inside, whatever its number would give
    const real a = MIN(MAX(madd(first, ray->step, ray->first), ray->enter), ray->leave);
    const real b = MIN(MAX(madd(last, ray->step, ray->first), ray->enter), ray->leave);
    const real3 p = at3(ray->origin, ray->direction, a), q = at3(ray->origin, ray->direction, b);
#define EXTEND(axis)                                                                       \
    box->low.axis = choose(active, MIN(box->low.axis, MIN(p.axis, q.axis)), box->low.axis); \
    box->high.axis = choose(active, MAX(box->high.axis, MAX(p.axis, q.axis)), box->high.axis)
    EXTEND(x); EXTEND(y); EXTEND(z);
#undef EXTEND
}

INLINE void box_nothing(boxes_t *box)
{
    box->low = real3_of(NOWHERE, NOWHERE, NOWHERE);
    box->high = real3_of(-NOWHERE, -NOWHERE, -NOWHERE);
}

// The first tap's place, among blocks, of a position on an axis of `blocks` of them.
INLINE int block_of(float x, int halo, int blocks)
{
    const float cell = x * GRID_SCALE - (LEFT - (float)halo), most = (float)(blocks * BLOCK - 1);
    return (int)(cell > 0.0f ? cell < most ? cell : most : 0.0f) / BLOCK;   // infinite where no lane is active
}

#define LOOKS 32   // blocks that are looked at for a box, at most

// The least and greatest value in the lanes' boxes. `margin` covers what positions are rounded by.
INLINE float2 values_within(global const float2 *bounds, const int4 extent, constant frame_t *frame, const boxes_t *box)
{
    const int halo = extent.w;
    const float m = frame->margin;
    int nx = frame->blocks[0], ny = frame->blocks[1], nz = frame->blocks[2];
    int x0 = block_of(min_lane(box->low.x) - m, halo, nx), x1 = block_of(max_lane(box->high.x) + m, halo, nx);
    int y0 = block_of(min_lane(box->low.y) - m, halo, ny), y1 = block_of(max_lane(box->high.y) + m, halo, ny);
    int z0 = block_of(min_lane(box->low.z) - m, halo, nz), z1 = block_of(max_lane(box->high.z) + m, halo, nz);
    int level = 0;
    while (level < frame->levels - 1 && (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1) > LOOKS) {
        x0 >>= 1; x1 >>= 1; y0 >>= 1; y1 >>= 1; z0 >>= 1; z1 >>= 1;
        nx = (nx + 1) >> 1; ny = (ny + 1) >> 1;
        ++level;
    }
    global const float2 *at = bounds + frame->level_at[level];
    float low = INFINITY, high = -INFINITY;
    for (int z = z0; z <= z1; ++z)
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) {
                const float2 b = at[((size_t)z * ny + y) * nx + x];
                low = b.x < low ? b.x : low;
                high = b.y > high ? b.y : high;
            }
    return (float2)(low, high);
}
