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

// Weights of LANES samples at once: by Horner's rule, tap by tap.
INLINE void lane_weights(real t, real w[TAPS])
{
#pragma unroll
    for (int i = 0; i < TAPS; ++i) {
        w[i] = (real)(filter_taps[i][DEGREE]);
#pragma unroll
        for (int k = DEGREE - 1; k >= 0; --k)
            w[i] = madd(w[i], t, filter_taps[i][k]);
    }
}

INLINE void lane_slopes(real t, real w[TAPS])
{
#pragma unroll
    for (int i = 0; i < TAPS; ++i) {
        w[i] = (real)(DEGREE * filter_taps[i][DEGREE]);
#pragma unroll
        for (int k = DEGREE - 1; k >= 1; --k)
            w[i] = madd(w[i], t, k * filter_taps[i][k]);
    }
}

// Where LANES samples lie in the patch. Positions outside are moved inside: lanes that are not active may ask
// for anything.
typedef struct { int at[LANES]; real tu, tv; } patch_cell_t;

INLINE patch_cell_t patch_locate(const patch_t *patch, real u, real v, int halo)
{
    patch_cell_t c;
    // counted from the patch's corner, hence not negative where it matters: cutting off is rounding down
    u = u * GRID_SCALE - (LEFT - (float)(halo - patch->u));
    v = v * GRID_SCALE - (LEFT - (float)(halo - patch->v));
    const lanes_u us = { least(greatest(u, (real)(0.0f)), (real)(PATCH - WEIGHTS)) }, vs = { least(greatest(v, (real)(0.0f)), (real)(PATCH - TAPS)) };
    lanes_u iu, iv;
#pragma unroll
    for (int i = 0; i < LANES; ++i) {
        const int column = (int)us.each[i], row = (int)vs.each[i];
        iu.each[i] = (float)column;
        iv.each[i] = (float)row;
        c.at[i] = row * PATCH + column;
    }
    c.tu = us.all - iu.all;
    c.tv = vs.all - iv.all;
    return c;
}

// Sums over rows of taps, a row for each lane. Two rows of four share a vector: kept in registers, they need no
// store that a wider load would have to wait for.
#define PAIRED (ROW == 4 && CHUNKS == 1 && LANES == 8)
#if PAIRED
typedef struct { float8 pairs[4]; } patch_rows_t;
#else
typedef struct { float taps[LANES][CHUNKS * ROW]; } patch_rows_t;
#endif

// LANES samples of a plane: what their value leaves for the gradient.
typedef struct { patch_cell_t cell; real wu[TAPS], wv[TAPS]; patch_rows_t rows; } here_t;

INLINE real patch_dot(const patch_rows_t *rows, const real wu[TAPS])
{
    real sum = (real)(0.0f);
#if PAIRED
    const float8 p = rows->pairs[0], q = rows->pairs[1], r = rows->pairs[2], s = rows->pairs[3];
#define COLUMN(i, k) (float8)(p.i, p.k, q.i, q.k, r.i, r.k, s.i, s.k)
    sum = wu[0] * COLUMN(s0, s4);
    sum = madd(wu[1], COLUMN(s1, s5), sum);
    sum = madd(wu[2], COLUMN(s2, s6), sum);
#if TAPS == 4
    sum = madd(wu[3], COLUMN(s3, s7), sum);
#endif
#undef COLUMN
#else
#pragma unroll
    for (int k = 0; k < TAPS; ++k) {
        lanes_u column;
#pragma unroll
        for (int i = 0; i < LANES; ++i)
            column.each[i] = rows->taps[i][k];
        sum = madd(wu[k], column.all, sum);
    }
#endif
    return sum;
}

// One row of the blend's taps, weighted by the lane's weights along v.
INLINE row_t patch_row(const float *p, const lanes_u w[TAPS], int lane)
{
    row_t sum = w[0].each[lane] * *(const row_at_t *)p;
#pragma unroll
    for (int j = 1; j < TAPS; ++j)
        sum = madd(w[j].each[lane], *(const row_at_t *)(p + j * PATCH), sum);
    return sum;
}

INLINE void patch_gather(const float *blend, const patch_cell_t *c, const real wv[TAPS], patch_rows_t *rows)
{
    lanes_u w[TAPS];
#pragma unroll
    for (int j = 0; j < TAPS; ++j)
        w[j].all = wv[j];
#if PAIRED
#pragma unroll
    for (int i = 0; i < 4; ++i)
        rows->pairs[i] = (float8)(patch_row(blend + c->at[2 * i], w, 2 * i), patch_row(blend + c->at[2 * i + 1], w, 2 * i + 1));
#else
    for (int i = 0; i < LANES; ++i)
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h)
            *(row_at_t *)(rows->taps[i] + h * ROW) = patch_row(blend + c->at[i] + h * ROW, w, i);
#endif
}
