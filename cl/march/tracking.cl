// Kernel: what matter leaves of light along given rays, of the function itself: what the sweeps of shadow.cl are measured by.
//
// Of matter with extinctions by ratio tracking (Novák, Selle and Jarosz 2014): tentative collisions at random distances, as in matter
// of a bound of the extinction, leave 1 - extinction / bound of the weight. The bounds of the min-max pyramid's blocks hold, so the
// mean of the weights is exp(-integral) without bias. Random numbers are functions of the ray, the path and the draw (Philox 2 x 32
// with 10 rounds, Salmon et al. 2011), so that two runs are equal bit for bit. Of surfaces crossings are counted, in short steps in
// the blocks that one may cross.
//
// Set by the host: SHEETS, whether matter is surfaces; BLOCK, cells along an edge of a block; and what pairs.cl needs.

#include "base/math.cl"
#include "spline/filter.cl"
#include "spline/taps.cl"
#include "spline/pairs.cl"

#define LITTLE 0.05f   // weights below this are doubled or dropped

INLINE uint philox(uint draw, uint path, uint ray)
{
    for (int round = 0; round < 10; ++round) {
        const uint high = mul_hi(0xD256D193u, draw);
        draw *= 0xD256D193u;
        const uint next = high ^ ray ^ path;
        path = draw;
        draw = next;
        ray += 0x9E3779B9u;
    }
    return draw;
}

// A random number above 0, up to 1.
INLINE float random(const uint draw, const uint path, const uint ray)
{
    return ((float)(philox(draw, path, ray) >> 8) + 1.0f) * 0x1p-24f;
}

typedef struct {
    int at[3], turn[3];       // the block, and the way to the next along each axis
    float next[3], apart[3];  // where the ray leaves it along each axis, and how far apart such places are
    float from, to;           // where the ray is in it
} walk_t;

INLINE void leave_at(walk_t *walk, const float length)
{
    walk->to = MIN(length, MIN(walk->next[0], MIN(walk->next[1], walk->next[2])));
}

INLINE walk_t begin_walk(const float *cells, const float *step, const float length)
{
    walk_t walk;
    for (int axis = 0; axis < 3; ++axis) {
        walk.at[axis] = (int)cells[axis] / BLOCK;
        walk.turn[axis] = step[axis] < 0.0f ? -1 : 1;
        const float face = (float)(BLOCK * (walk.at[axis] + (step[axis] > 0.0f)));
        walk.next[axis] = step[axis] == 0.0f ? INFINITY : (face - cells[axis]) / step[axis];
        walk.apart[axis] = step[axis] == 0.0f ? INFINITY : BLOCK / MAX(step[axis], -step[axis]);
    }
    walk.from = 0.0f;
    leave_at(&walk, length);
    return walk;
}

INLINE void next_block(walk_t *walk, const float length)
{
    const int axis = walk->next[0] <= walk->next[1] ? (walk->next[0] <= walk->next[2] ? 0 : 2) : walk->next[1] <= walk->next[2] ? 1 : 2;
    walk->from = walk->to;
    walk->at[axis] += walk->turn[axis];
    walk->next[axis] += walk->apart[axis];
    leave_at(walk, length);
}

INLINE float bound_of(global const float *bounds, const int4 blocks, const walk_t *walk)
{
    const int x = MIN(MAX(walk->at[0], 0), blocks.x - 1), y = MIN(MAX(walk->at[1], 0), blocks.y - 1), z = MIN(MAX(walk->at[2], 0), blocks.z - 1);
    return bounds[((size_t)z * blocks.y + y) * blocks.x + x];
}

INLINE float value_at(COEFFICIENTS coefficients, const int4 extent, const float *origin, const float *way, const float t)
{
    return sample_value(coefficients, extent,
                        locate_inner(madd(t, way[0], origin[0]), madd(t, way[1], origin[1]), madd(t, way[2], origin[2]), extent.w));
}

#if SHEETS

// Of surfaces, `matter` has values and exponents of what crossing them leaves of light.
INLINE float exponents_below(global const float2 *matter, const int count, const float value, const float before)
{
    float sum = 0.0f;
    for (int k = 0; k < count; ++k)
        sum += (value >= matter[k].x) != (before >= matter[k].x) ? matter[k].y : 0.0f;
    return sum;
}

#else

// `matter` has values and opacities; `scale` and `most` are of exponents for each world unit.
INLINE float extinction_of(global const float2 *matter, const int count, const float value, const float scale, const float most)
{
    float opacity = matter[0].y;
    for (int k = 1; k < count; ++k) {
        const float2 a = matter[k - 1], b = matter[k];
        if (value >= a.x)
            opacity = value >= b.x ? b.y : madd((value - a.x) / (b.x - a.x), b.y - a.y, a.y);
    }
    return MIN(-scale * log2(MAX(1.0f - opacity, 1e-37f)), most);
}

#endif

// `rays` have, of each, the place in samples where it enters the domain and its length there; its way in samples for each world unit,
// and how far away it enters. Far away matter counts less: times 2 to the `fade` per world unit. `bounds` are extinctions. For surfaces,
// `scale` is the length of steps, and `bounds` say where some may be. Writes the means of weights and of their squares over `paths`.
kernel void track(COEFFICIENTS coefficients, const int4 extent, global const float *bounds, const int4 blocks, global const float2 *matter,
                  const int count, const float scale, const float most, const float fade, const int paths, global const float8 *rays,
                  global float2 *result)
{
    const uint number = get_global_id(0);
    const float8 ray = rays[number];
    const float origin[3] = { ray.s0, ray.s1, ray.s2 }, way[3] = { ray.s4, ray.s5, ray.s6 }, length = ray.s3;
    float cells[3], step[3];
    for (int axis = 0; axis < 3; ++axis) {
        cells[axis] = GRID_POSITION(origin[axis], LEFT - (float)extent.w);
        step[axis] = way[axis] * GRID_SCALE;
    }
    float sum = 0.0f, squares = 0.0f;
#if SHEETS
    (void)most, (void)fade, (void)paths, (void)squares;
    float before = value_at(coefficients, extent, origin, way, 0.0f);
    for (walk_t walk = begin_walk(cells, step, length); walk.from < length; next_block(&walk, length))
        if (bound_of(bounds, blocks, &walk) > 0.0f) {
            const int steps = (int)((walk.to - walk.from) / scale) + 1;
            for (int n = 1; n <= steps; ++n) {
                const float here = value_at(coefficients, extent, origin, way, walk.from + n * (walk.to - walk.from) / steps);
                sum += exponents_below(matter, count, here, before);
                before = here;
            }
        }
    const float left = exp2(-sum);
    result[number] = (float2)(left, left * left);
#else
    for (int path = 0; path < paths; ++path) {
        float weight = 1.0f;
        uint draw = 0;
        for (walk_t walk = begin_walk(cells, step, length); walk.from < length && weight != 0.0f; next_block(&walk, length)) {
            const float bound = bound_of(bounds, blocks, &walk);
            if (bound > 0.0f)
                for (float t = walk.from; weight != 0.0f;) {
                    t -= log2(random(draw++, path, number)) / bound;
                    if (t >= walk.to)
                        break;
                    const float there = extinction_of(matter, count, value_at(coefficients, extent, origin, way, t), scale, most);
                    weight *= 1.0f - there * exp2(-fade * (ray.s7 + t)) / bound;
                    if (weight < LITTLE)
                        weight = random(draw++, path, number) > 0.5f ? 0.0f : 2.0f * weight;
                }
        }
        sum += weight;
        squares = madd(weight, weight, squares);
    }
    result[number] = (float2)(sum / paths, squares / paths);
#endif
}
