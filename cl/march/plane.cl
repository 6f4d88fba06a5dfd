// Plane marching: the weights along the axis across the planes are the same for every sample on one plane, so
// the coefficient slices under a tile of pixels are blended once for the tile, and each sample takes TAPS x TAPS
// taps of the blend instead of TAPS^3 of the volume.
//
// u and v are the two axes of a plane: x before y before z.

#include "spline/filter.cl"

#define PATCH 48      // coefficients along an edge of a patch, at most
#define PATCH_ROOM (PATCH * PATCH + 8)

typedef struct {
    long along_u, along_v, across;   // strides of the stored coefficients
    int u, v;                        // the first stored coefficient under the patch ...
    float from_u, from_v;            // ... and where its cell begins
    int columns, rows;               // how many it holds
    int slice;                       // the first slice that takes part, and the fraction past it
    float t;
    int made, usable;                // whether it was asked for, and whether the plane's footprint fits in
    int sloped;                      // whether `slopes` is filled for this plane
    float values[PATCH_ROOM], slopes[PATCH_ROOM];
} patch_t;

// Blends the slices that take part, with these weights.
RARE void patch_blend(const patch_t *patch, global const float *coefficients, int slopes, float *blend)
{
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
                    sum = madd(w[k], *(global const float8_at *)(p + k * patch->across), sum);
                *(float8_at *)(blend + j * PATCH + i) = sum;
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

// Asks for the coefficients that the planes after this one will need.
INLINE void patch_ahead(const patch_t *patch, COEFFICIENTS coefficients, const int4 extent, int axis, float way)
{
    const int slice = patch->slice + (way > 0.0f ? TAPS + 1 : -2), slices = axis == 1 ? extent.y : extent.z;
    if (axis == 0 || slice < 0 || slice >= slices)   // along x they lie in the lines at hand
        return;
    global const float *row = coefficients + patch->u + patch->v * patch->along_v + slice * patch->across;
    for (int j = 0; j < patch->rows; ++j, row += patch->along_v)
        for (int i = 0; i < patch->columns + 15; i += 16)
            PREFETCH(row + i);
}

// Takes the plane at `across`, on the way of rays up or down its axis, under positions from (low_u, low_v) to (high_u, high_v), all in samples.
INLINE void patch_move(patch_t *patch, COEFFICIENTS coefficients, const int4 extent, int axis, float way, float across, float low_u, float high_u, float low_v, float high_v)
{
    const long row = extent.x, slice = row * extent.y;
    patch->along_u = axis == 0 ? row : 1;
    patch->along_v = axis == 2 ? row : slice;
    patch->across = axis == 0 ? 1 : axis == 1 ? row : slice;
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
    patch->from_u = LEFT - (float)(halo - patch->u);
    patch->from_v = LEFT - (float)(halo - patch->v);
    if (patch->usable) {
        patch_ahead(patch, coefficients, extent, axis, way);
        patch_blend(patch, coefficients, 0, patch->values);
    }
}

// Where LANES samples lie in the patch. Positions outside are moved inside: lanes that are not active may ask
// for anything.
typedef struct { lane_indices_u at; real tu, tv; } patch_cell_t;

INLINE patch_cell_t patch_locate(const patch_t *patch, real u, real v)
{
    patch_cell_t c;
    // counted from the patch's corner, hence not negative where it matters: cutting off is rounding down
    u = u * GRID_SCALE - patch->from_u;
    v = v * GRID_SCALE - patch->from_v;
    u = MIN(MAX(u, (real)(0.0f)), (real)(PATCH - WEIGHTS));
    v = MIN(MAX(v, (real)(0.0f)), (real)(PATCH - TAPS));
    const mask column = to_mask(u), row = to_mask(v);
    c.at.all = row * PATCH + column;
    c.tu = u - to_real(column);
    c.tv = v - to_real(row);
    return c;
}

// LANES samples of a plane: what their value leaves for the gradient.
typedef struct { patch_cell_t cell; real wu[TAPS], wv[TAPS], columns[TAPS]; } here_t;

// Sums over rows of the blend's taps, weighted along v: column k holds the sum at tap k along u, for all lanes.
INLINE void patch_gather(const float *blend, const patch_cell_t *c, const real wv[TAPS], real columns[TAPS])
{
#if ROW == 4 && CHUNKS == 1 && LANES > 1
    real rows[4], transposed[4];
#define TAP_ROW(i) *(const row_at_t *)(p + c->at.each[i])
#define GATHER(i, each)                                                              \
    for (int j = 0; j < TAPS; ++j) {                                                 \
        const float *p = blend + j * PATCH;                                          \
        const real taps = FOURTHS(TAP_ROW, i);                                       \
        rows[i] = j == 0 ? each(wv[j]) * taps : madd(each(wv[j]), taps, rows[i]);    \
    }
    _Pragma("unroll") GATHER(0, EACH_0)
    _Pragma("unroll") GATHER(1, EACH_1)
    _Pragma("unroll") GATHER(2, EACH_2)
    _Pragma("unroll") GATHER(3, EACH_3)
#undef GATHER
#undef TAP_ROW
    transpose_fourths(rows, transposed);
#pragma unroll
    for (int k = 0; k < TAPS; ++k)
        columns[k] = transposed[k];
#else
    lanes_u w[TAPS];
    real taps[CHUNKS * ROW];
#pragma unroll
    for (int j = 0; j < TAPS; ++j)
        w[j].all = wv[j];
#pragma unroll
    for (int h = 0; h < CHUNKS; ++h) {
        row_t rows[LANES];
        for (int i = 0; i < LANES; ++i) {
            const float *p = blend + c->at.each[i] + h * ROW;
            rows[i] = w[0].each[i] * *(const row_at_t *)p;
#pragma unroll
            for (int j = 1; j < TAPS; ++j)
                rows[i] = madd(w[j].each[i], *(const row_at_t *)(p + j * PATCH), rows[i]);
        }
        lane_taps(rows, taps + h * ROW);
    }
#pragma unroll
    for (int k = 0; k < TAPS; ++k)
        columns[k] = taps[k];
#endif
}
