// Opacity by more than the value: times factors by how steep the function is, and by how its isosurfaces bend; or of an image, by value
// and steepness both (scene/factor.py, scene/joint.py).
//
// Set by the host: GRADED, the sum of 1 for factors by the gradient, 2 by curvature, and 4 for an image.

#include "transfer/ramp.cl"

#define BY_GRADIENT 0
#define BY_CURVATURE 1
#define MOST_POINTS 16

INLINE real factor_of(constant factors_block *factors, const int which, const real x)
{
    const int first = which * MOST_POINTS;
    real factor = (real)(factors->base[first]);
    for (int i = first; i < first + factors->count[which]; ++i)
        factor = choose(x >= factors->start[i], madd(x - factors->start[i], (real)(factors->slope[i]), (real)(factors->base[i])), factor);
    return MIN(MAX(factor, (real)(0.0f)), (real)(1.0f));
}

// Whether the factor is 0 from low to high.
INLINE int none_within(constant factors_block *factors, const int which, const float low, const float high)
{
    const int first = which * MOST_POINTS, last = first + factors->count[which] - 1;
    int none = factors->base[first] == 0.0f || low >= factors->start[first];
    for (int i = first; i <= last; ++i) {
        const int begun = high >= factors->start[i], over = i < last && low > factors->start[i + 1];
        none &= (factors->base[i] == 0.0f && factors->slope[i] == 0.0f) || !begun || over;
    }
    return none;
}

// The colour with this factor of its opacity.
INLINE color_t thinned(color_t color, const real factor)
{
    color.opacity *= factor;
    color.clear = madd(factor, color.clear, 1.0f - factor);
    return color;
}

#if GRADED & 4

// The nodes of an image, row by row of equal steepness: colours times opacity, and opacity; behind them, of how many nodes there are
// before each row and column that have some.
INLINE float2 node_of(constant joint_block *joint, const float value, const float steepness)
{
    const float column = (value - joint->low) * joint->scale, row = steepness * joint->per_slope;
    return (float2)(MIN(MAX(column, 0.0f), (float)(joint->columns - 1)), MIN(MAX(row, 0.0f), (float)(joint->rows - 1)));
}

INLINE color_t classify_jointly(constant joint_block *joint, global const float4 *table, const real value, const real steepness)
{
    const lanes_u values = { value }, slopes = { steepness };
    lanes_u red, green, blue, opacity;
    for (int i = 0; i < LANES; ++i) {
        const float2 place = node_of(joint, values.each[i], slopes.each[i]);
        const int x = MIN((int)place.x, joint->columns - 2), y = MIN((int)place.y, joint->rows - 2);
        global const float4 *node = table + joint->at + y * joint->columns + x, *next = node + joint->columns;
        const float right = place.x - (float)x, up = place.y - (float)y;
        const float4 below = madd((float4)(right), node[1] - node[0], node[0]), above = madd((float4)(right), next[1] - next[0], next[0]);
        const float4 c = madd((float4)(up), above - below, below);
        red.each[i] = c.x; green.each[i] = c.y; blue.each[i] = c.z; opacity.each[i] = c.w;
    }
    const real per_opacity = 1.0f / MAX(opacity.all, (real)(1e-20f));
    const color_t color = { red.all * per_opacity, green.all * per_opacity, blue.all * per_opacity, opacity.all, 1.0f - opacity.all };
    return color;
}

// Whether nothing has opacity between these values and steepnesses.
INLINE int transparent_jointly(constant joint_block *joint, global const float4 *table, const float2 values, const float2 slopes)
{
    const float2 low = node_of(joint, values.x, slopes.x), high = node_of(joint, values.y, slopes.y);
    const int x0 = MIN((int)low.x, joint->columns - 2), y0 = MIN((int)low.y, joint->rows - 2);
    const int x1 = MIN((int)high.x, joint->columns - 2) + 2, y1 = MIN((int)high.y, joint->rows - 2) + 2;
    global const float *before = (global const float *)(table + joint->at + joint->rows * joint->columns);
    const int pitch = joint->columns + 1;
    return before[y1 * pitch + x1] - before[y0 * pitch + x1] == before[y1 * pitch + x0] - before[y0 * pitch + x0];
}

#endif
