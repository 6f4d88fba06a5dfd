// From a value to a colour and an opacity, by linear interpolation in a table of TABLE_SIZE nodes.
//
// Set by the host: TABLE_SIZE.

#include "base/math.cl"
#include "base/transpose.cl"
#include "frame.cl"

typedef struct { real red, green, blue, opacity; } color_t;

INLINE color_t classify(constant frame_t *frame, global const float4 *table, real value)
{
    const real place = MIN(MAX((value - frame->transfer.low) * frame->transfer.scale, (real)(0.0f)), (real)(TABLE_SIZE - 1.0f));
    const mask nodes = to_mask(MIN(place, (real)(TABLE_SIZE - 2.0f)));
    const lane_indices_u node = { 4 * nodes };
    const real past = place - to_real(nodes);
#if LANES == 1
    const float4 c = madd(past, table[nodes + 1] - table[nodes], table[nodes]);
    const color_t color = { c.x, c.y, c.z, c.w };
#else
    global const float *channel = (global const float *)table;
    real rows[4], channels[4];
#define LOW(i) *(global const float4 *)(channel + node.each[i])
#define HIGH(i) *(global const float4 *)(channel + node.each[i] + 4)
#define COLORS(i, each) rows[i] = madd(each(past), FOURTHS(HIGH, i) - FOURTHS(LOW, i), FOURTHS(LOW, i));
    COLORS(0, EACH_0)
    COLORS(1, EACH_1)
    COLORS(2, EACH_2)
    COLORS(3, EACH_3)
#undef COLORS
#undef LOW
#undef HIGH
    transpose_fourths(rows, channels);
    const color_t color = { channels[0], channels[1], channels[2], channels[3] };
#endif
    return color;
}

// Whether no value from low to high has any opacity. Behind the table's nodes lie TABLE_SIZE numbers: for each node,
// the next one that has some, itself included.
INLINE int transparent(constant frame_t *frame, global const float4 *table, float low, float high)
{
    if (low > high)
        return 1;   // no values
    global const float *visible = (global const float *)(table + TABLE_SIZE);
    const float bottom = (low - frame->transfer.low) * frame->transfer.scale, top = (high - frame->transfer.low) * frame->transfer.scale;
    if (!(bottom - bottom == 0.0f && top - top == 0.0f))
        return 0;
    const float last = TABLE_SIZE - 1.0f;
    const float from = bottom > 0.0f ? MIN(bottom, last) : 0.0f, to = top > 0.0f ? MIN(top, last) : 0.0f;
    return visible[(int)from] >= to + 1.0f;   // the first node that is seen colours what lies past the one before it
}

// Opacity of matter `thickness` unit distances thick, given that of one.
INLINE real opacity_of(real opacity, real thickness)
{
    const real share = 1.0f - exp_2(thickness * log_2(MAX(1.0f - opacity, (real)(1e-30f))));
    return choose(opacity < 1.0f, share, (real)(1.0f));
}
