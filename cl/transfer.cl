// From a value to a colour and an opacity, by linear interpolation in a table of TABLE_SIZE nodes.

typedef struct { real red, green, blue, opacity; } color_t;

INLINE float4 classify_one(constant frame_t *frame, global const float4 *table, float value)
{
    float u = (value - frame->table_low) * frame->table_scale;
    u = u > 0.0f ? u : 0.0f;
    u = u < TABLE_SIZE - 1.0f ? u : TABLE_SIZE - 1.0f;
    int i = (int)u;
    i = i < TABLE_SIZE - 2 ? i : TABLE_SIZE - 2;
    return madd(u - (float)i, table[i + 1] - table[i], table[i]);
}

INLINE color_t classify(constant frame_t *frame, global const float4 *table, real value)
{
    color_t color;
#if LANES == 1
    const float4 c = classify_one(frame, table, value);
    color.red = c.x; color.green = c.y; color.blue = c.z; color.opacity = c.w;
#else
    float v[LANES], r[LANES], g[LANES], b[LANES], a[LANES];
    PASTE(vstore, LANES)(value, 0, v);
    for (int i = 0; i < LANES; ++i) {
        const float4 c = classify_one(frame, table, v[i]);
        r[i] = c.x; g[i] = c.y; b[i] = c.z; a[i] = c.w;
    }
    color.red = PASTE(vload, LANES)(0, r); color.green = PASTE(vload, LANES)(0, g);
    color.blue = PASTE(vload, LANES)(0, b); color.opacity = PASTE(vload, LANES)(0, a);
#endif
    return color;
}

// Opacity of matter `thickness` unit distances thick, given that of one.
INLINE real opacity_of(real opacity, real thickness)
{
    const real share = 1.0f - exp2(thickness * log2(fmax(1.0f - opacity, (real)(1e-30f))));
    return choose(opacity < 1.0f, share, (real)(1.0f));
}
