// Kernel: the colours of rays through places anywhere in the picture, near ones together.

#include "march/march.cl"

// at: the places, in pixels from the picture's upper left corner; count: of all of them; colors: premultiplied, and opacity.
kernel void draw_rays(COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax, global const ulong2 *sides,
                      constant frame_t *frame, global const float4 *table, global const float2 *at, const int count,
                      global float4 *colors)
{
    const int first = (int)get_global_id(0) * (PACKETS * LANES);
    if (first >= count)
        return;
    tile_t tile;
    tile.left = tile.top = 0;
    tile.first = INFINITY;
    tile.last = -INFINITY;
    tile.planar = 0;   // no rectangle holds them: each takes its samples by itself
    tile.way = 1.0f;
    for (int g = 0; g < PACKETS; ++g) {
        lanes_u x, y, there;
        for (int i = 0; i < LANES; ++i) {
            const int ray = first + g * LANES + i;
            const float2 place = at[MIN(ray, count - 1)];
            x.each[i] = place.x;
            y.each[i] = place.y;
            there.each[i] = ray < count ? 1.0f : 0.0f;
        }
        begin_packet(&tile, frame, g, x.all, y.all, there.all > 0.0f);
    }
    march_tile(&tile, coefficients, extent, minmax, sides, frame, table);

    plane_t none;   // no sample is being gathered
    none.usable = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const sample_t sample = { frame, table, extent, tile.rays + g, &none, 0, 0.0f, 0 };
        real t;
        const color_t color = finish(tile.states + g, coefficients, &sample, &t);
        const lanes_u red = { color.red }, green = { color.green }, blue = { color.blue }, opacity = { color.opacity };
        for (int i = 0; i < LANES; ++i) {
            const int ray = first + g * LANES + i;
            if (ray < count)
                colors[ray] = (float4)((float3)(red.each[i], green.each[i], blue.each[i]) * opacity.each[i], opacity.each[i]);
        }
    }
}
