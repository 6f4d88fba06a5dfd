// Plane marching: the weights along the axis across the planes are the same for every sample on one plane, so
// the coefficient slices under a tile of pixels are blended once for the tile, and each sample takes TAPS x TAPS
// taps of the blend instead of TAPS^3 of the volume.
//
// u and v are the two axes of a plane: x before y before z.

#define PATCH 48      // coefficients along an edge of a patch, at most
#define PATCH_ROOM (PATCH * PATCH + 8)

typedef struct {
    long along_u, along_v, across;   // strides of the stored coefficients
    int u, v;                        // the first stored coefficient under the patch
    int columns, rows;               // how many it holds
    int slice;                       // the first slice that takes part, and the fraction past it
    float t;
    int usable;                      // whether the plane's footprint fits in
    int sloped;                      // whether `slopes` is filled for this plane
    float values[PATCH_ROOM], slopes[PATCH_ROOM];
} patch_t;

INLINE void patch_begin(patch_t *patch, const int4 extent, int axis)
{
    const long row = extent.x, slice = row * extent.y;
    patch->along_u = axis == 0 ? row : 1;
    patch->along_v = axis == 2 ? row : slice;
    patch->across = axis == 0 ? 1 : axis == 1 ? row : slice;
    for (int i = 0; i < PATCH_ROOM; ++i)
        patch->values[i] = patch->slopes[i] = 0.0f;   // what no tap reaches is multiplied by zero
}

// Blends the slices that take part, with these weights.
RARE void patch_blend(const patch_t *patch, global const float *coefficients, int slopes, float *blend)
{
    typedef float8 eight_t __attribute__((aligned(4)));
    global const float *first = coefficients + patch->u * patch->along_u + patch->v * patch->along_v
        + patch->slice * patch->across;
    float w[WEIGHTS];
    if (slopes)
        unpack_slopes(patch->t, w);
    else
        unpack_weights(patch->t, w);
    if (patch->along_u == 1) {
        for (int j = 0; j < patch->rows; ++j)
            for (int i = 0; i < patch->columns; i += 8) {
                global const float *p = first + j * patch->along_v + i;
                float8 sum = (float8)(0.0f);
#pragma unroll
                for (int k = 0; k < TAPS; ++k)
                    sum = madd(w[k], *(global const eight_t *)(p + k * patch->across), sum);
                *(eight_t *)(blend + j * PATCH + i) = sum;
            }
    } else {
        // the planes are perpendicular to x: the taps to blend lie side by side
        row_u weights[CHUNKS];
#pragma unroll
        for (int k = 0; k < WEIGHTS; ++k)
            weights[k / ROW].each[k % ROW] = w[k];
        for (int j = 0; j < patch->rows; ++j)
            for (int i = 0; i < patch->columns; ++i) {
                global const float *p = first + j * patch->along_v + i * patch->along_u;
                float sum = 0.0f;
#pragma unroll
                for (int k = 0; k < CHUNKS; ++k)
                    sum += row_sum(weights[k].row * *(global const row_at_t *)(p + k * ROW));
                blend[j * PATCH + i] = sum;
            }
    }
}

// Takes the plane at `across`, under positions from (low_u, low_v) to (high_u, high_v), all in samples.
INLINE void patch_move(patch_t *patch, VOLUME_PARAMS, int axis, float across, float low_u, float high_u, float low_v, float high_v)
{
    const int halo = extent.w, limit_u = axis == 0 ? extent.y : extent.x, limit_v = axis == 2 ? extent.y : extent.z;
    float t;
    patch->slice = locate_axis(across, &patch->t) + halo;
    const int u0 = locate_axis(low_u - 0.01f, &t) + halo, u1 = locate_axis(high_u + 0.01f, &t) + halo + WEIGHTS;
    const int v0 = locate_axis(low_v - 0.01f, &t) + halo, v1 = locate_axis(high_v + 0.01f, &t) + halo + TAPS;
    patch->u = u0 > 0 ? u0 : 0;
    patch->v = v0 > 0 ? v0 : 0;
    patch->columns = (u1 < limit_u ? u1 : limit_u) - patch->u;
    patch->rows = (v1 < limit_v ? v1 : limit_v) - patch->v;
    patch->usable = patch->columns <= PATCH && patch->rows <= PATCH && patch->columns > 0 && patch->rows > 0;
    patch->sloped = 0;
    if (patch->usable)
        patch_blend(patch, coefficients, 0, patch->values);
}

// A sample on the plane: the patch's taps, or the derivative along u or v. Positions outside are moved inside:
// lanes that are not active may ask for anything.
typedef struct { int at; float tu, tv; } patch_cell_t;

INLINE patch_cell_t patch_locate(const patch_t *patch, float u, float v, int halo)
{
    patch_cell_t c;
    int i = locate_axis(u, &c.tu) + halo - patch->u, j = locate_axis(v, &c.tv) + halo - patch->v;
    i = i < 0 ? 0 : i > PATCH - WEIGHTS ? PATCH - WEIGHTS : i;
    j = j < 0 ? 0 : j > PATCH - TAPS ? PATCH - TAPS : j;
    c.at = j * PATCH + i;
    return c;
}

INLINE float patch_value(const float *blend, patch_cell_t c)
{
    float wv[WEIGHTS], value = 0.0f;
    unpack_weights(c.tv, wv);
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        row_t sum = (row_t)(0.0f);
#pragma unroll
        for (int j = 0; j < TAPS; ++j)
            sum = madd(wv[j], *(const row_at_t *)(blend + c.at + j * PATCH + i * ROW), sum);
        value += row_sum(sum * tap_weights(c.tu, i));
    }
    return value;
}

// Derivatives along u and v of the blend.
INLINE void patch_slopes(const float *blend, patch_cell_t c, float *du, float *dv)
{
    float wv[WEIGHTS], sv[WEIGHTS];
    unpack_weights(c.tv, wv);
    unpack_slopes(c.tv, sv);
    *du = *dv = 0.0f;
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        row_t sum = (row_t)(0.0f), sum_v = sum;
#pragma unroll
        for (int j = 0; j < TAPS; ++j) {
            const row_t row = *(const row_at_t *)(blend + c.at + j * PATCH + i * ROW);
            sum = madd(wv[j], row, sum);
            sum_v = madd(sv[j], row, sum_v);
        }
        *du += row_sum(sum * tap_slopes(c.tu, i));
        *dv += row_sum(sum_v * tap_weights(c.tu, i));
    }
}
