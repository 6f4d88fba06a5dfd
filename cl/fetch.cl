// One row of coefficients, or one trilinear fetch, from a buffer or from an image.
//
// Coefficients are stored with a halo on every side, filled by the boundary rule (halo.cl), so that
// nothing that lies in the volume's domain ever asks past the edge. Coordinates here count from the
// first stored coefficient. extent = (row pitch, rows, slices, halo).

#if FETCH_IMAGE

#define VOLUME_PARAMS read_only image3d_t coefficients, const int4 extent
#define VOLUME coefficients, extent

constant sampler_t texel_sampler = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_NEAREST;
constant sampler_t linear_sampler = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_LINEAR;

inline float fetch_one(VOLUME_PARAMS, int x, int y, int z)
{
    return read_imagef(coefficients, texel_sampler, (int4)(x, y, z, 0)).x;
}

inline row_t fetch_row(VOLUME_PARAMS, int x, int y, int z)
{
    float row[ROW];
#pragma unroll
    for (int i = 0; i < ROW; ++i)
        row[i] = fetch_one(VOLUME, x + i, y, z);
    return LOAD_ROW(row);
}

inline float fetch_linear(VOLUME_PARAMS, float x, float y, float z)
{
    return read_imagef(coefficients, linear_sampler, (float4)(x + 0.5f, y + 0.5f, z + 0.5f, 0.0f)).x;
}

#else

#define VOLUME_PARAMS global const float *restrict coefficients, const int4 extent
#define VOLUME coefficients, extent

inline size_t offset_of(const int4 extent, int x, int y, int z)
{
    return ((size_t)z * extent.y + y) * extent.x + x;
}

inline float fetch_one(VOLUME_PARAMS, int x, int y, int z)
{
    return coefficients[offset_of(extent, x, y, z)];
}

inline row_t fetch_row(VOLUME_PARAMS, int x, int y, int z)
{
    return LOAD_ROW(coefficients + offset_of(extent, x, y, z));
}

inline float fetch_linear(VOLUME_PARAMS, float x, float y, float z)
{
    const float fx = floor(x), fy = floor(y), fz = floor(z);
    const float tx = x - fx, ty = y - fy;
    global const float *p = coefficients + offset_of(extent, (int)fx, (int)fy, (int)fz);
    global const float *q = p + extent.x;
    float plane = mix(mix(p[0], p[1], tx), mix(q[0], q[1], tx), ty);
#if DIMENSIONS == 3
    p += (size_t)extent.x * extent.y;
    q = p + extent.x;
    plane = mix(plane, mix(mix(p[0], p[1], tx), mix(q[0], q[1], tx), ty), z - fz);
#endif
    return plane;
}

#endif
