// From a value to a colour and an opacity, by linear interpolation in a table of TABLE_SIZE nodes.

typedef struct { real red, green, blue, opacity; } color_t;

INLINE color_t classify(constant frame_t *frame, global const float4 *table, real value)
{
    const real place = least(greatest((value - frame->table_low) * frame->table_scale, (real)(0.0f)), (real)(TABLE_SIZE - 1.0f));
    const mask nodes = to_mask(least(place, (real)(TABLE_SIZE - 2.0f)));
    const lane_masks_u node = { nodes };
    const lanes_u past = { place - to_real(nodes) };
#define COLOR(i) madd(past.each[i], table[node.each[i] + 1] - table[node.each[i]], table[node.each[i]])
#if LANES == 1
    const float4 c = COLOR(0);
    const color_t color = { c.x, c.y, c.z, c.w };
#else
    const float8 p = (float8)(COLOR(0), COLOR(1)), q = (float8)(COLOR(2), COLOR(3)), r = (float8)(COLOR(4), COLOR(5)), s = (float8)(COLOR(6), COLOR(7));
#define CHANNEL(i, k) (float8)(p.i, p.k, q.i, q.k, r.i, r.k, s.i, s.k)
    const color_t color = { CHANNEL(s0, s4), CHANNEL(s1, s5), CHANNEL(s2, s6), CHANNEL(s3, s7) };
#undef CHANNEL
#endif
#undef COLOR
    return color;
}

// Whether no value from low to high has any opacity. Behind the table's nodes lie TABLE_SIZE numbers: for each node,
// the next that has some, itself included.
INLINE int transparent(constant frame_t *frame, global const float4 *table, float low, float high)
{
    global const float *visible = (global const float *)(table + TABLE_SIZE);
    const float bottom = (low - frame->table_low) * frame->table_scale, top = (high - frame->table_low) * frame->table_scale;
    const float most = TABLE_SIZE - 1.0f;
    if (!(bottom - bottom == 0.0f && top - top == 0.0f))
        return 0;
    const int first = (int)(bottom > 0.0f ? bottom < most ? bottom : most : 0.0f), last = (int)(top > 0.0f ? top < most ? top : most : 0.0f);
    return visible[first] > last + 1;
}

// Opacity of matter `thickness` unit distances thick, given that of one.
INLINE real opacity_of(real opacity, real thickness)
{
    const real share = 1.0f - exp_2(thickness * log_2(greatest(1.0f - opacity, (real)(1e-30f))));
    return choose(opacity < 1.0f, share, (real)(1.0f));
}
