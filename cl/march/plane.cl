// The blended plane under a tile of rays: makes marching fast on CPUs.
//
// All rays of a tile cross the same planes of samples, and the weights along the axis across a plane are the same for every
// sample on it. So the slices of coefficients under the tile are blended once per plane, and a sample takes TAPS × TAPS taps of
// the blend instead of TAPS³ of the volume:
//
//   a cubic sample       16 loads of rows of four taps from the volume, or 4 from the blend
//   its gradient         the same rows again, and 4 of a second blend with slopes across
//   16 × 16 rays         blend some 19 × 19 coefficients, half a voxel apart even fewer
//
// u and v are the two axes of a plane: x before y before z.

#include "base/lanes.cl"
#include "base/transpose.cl"
#include "spline/cell.cl"
#include "spline/fetch.cl"
#include "spline/filter.cl"
#include "march/window.cl"

#if PLANES
#define PLANE_EDGE 64   // coefficients along an edge of a plane, at most: rays may lie 3.7 voxels apart
#else
#define PLANE_EDGE 48   // none is made, but a compiler may keep its room
#endif
#define PLANE_ROOM (PLANE_EDGE * PLANE_EDGE + 8)

typedef struct {
    long along_u, along_v, across;   // strides of the stored coefficients
    int u, v;                        // the first stored coefficient under the tile ...
    float from_u, from_v;            // ... and where its cell begins (cell_origin)
    int columns, rows;               // how many there are
    int first_column, first_row;     // those before are not resident, and not needed
    int slice;                       // the first slice that takes part, and the fraction past it
    float t;
    int made, usable;                // whether it has been blended, and whether the tile's footprint fits
    int sloped;                      // whether `slopes` is filled for this plane
    float values[PLANE_ROOM], slopes[PLANE_ROOM];
} plane_t;

// Blends the slices that take part, with weights or with slopes across.
OUT_OF_LINE void plane_blend(const plane_t *plane, global const float *coefficients, int slopes, float *blend)
{
    global const float *first = coefficients + plane->u * plane->along_u + plane->v * plane->along_v
        + plane->slice * plane->across;
    float w[WEIGHTS];
    if (slopes)
        unpack_slopes(plane->t, w);
    else
        unpack_weights(plane->t, w);
    if (plane->along_u == 1) {
        for (int j = plane->first_row; j < plane->rows; ++j)
            for (int i = plane->first_column; i < plane->columns; i += 8) {
                global const float *p = first + j * plane->along_v + i;
                float8 sum = (float8)(0.0f);
#pragma unroll
                for (int k = 0; k < TAPS; ++k)
                    sum = madd(w[k], *(global const scalar8_at *)(p + k * plane->across), sum);
                *(scalar8_at *)(blend + j * PLANE_EDGE + i) = sum;
            }
    } else {
        // the planes are perpendicular to x: the taps to blend lie side by side
        row_u weights[CHUNKS];
#pragma unroll
        for (int k = 0; k < WEIGHTS; ++k)
            weights[k / ROW].each[k % ROW] = w[k];
        for (int j = plane->first_row; j < plane->rows; ++j)
            for (int i = plane->first_column; i < plane->columns; ++i) {
                global const float *p = first + j * plane->along_v + i * plane->along_u;
                float sum = 0.0f;
#pragma unroll
                for (int k = 0; k < CHUNKS; ++k)
                    sum += row_sum(weights[k].row * *(global const row_at_t *)(p + k * ROW));
                blend[j * PLANE_EDGE + i] = sum;
            }
    }
}

// Prefetches the coefficients for the planes after this one.
INLINE void plane_ahead(const plane_t *plane, global const float *coefficients, const int4 extent, constant frame_t *frame, float way)
{
    const int slice = plane->slice + (way > 0.0f ? TAPS + 1 : -2), axis = frame->planes.axis;
    if (axis == 0 || slice < STORED_FROM(frame, axis) || slice >= STORED_TO(frame, extent, axis))   // along x they are in the lines already loaded
        return;
    for (int j = plane->first_row; j < plane->rows; ++j) {
        global const float *row = coefficients + plane->u + (plane->v + j) * plane->along_v + slice * plane->across;
        for (int i = plane->first_column; i < plane->columns + 15; i += 16)
            PREFETCH(row + i);
    }
}

// Moves to the plane at `across`, for rays that go up (way > 0) or down its axis, under positions from (low_u, low_v) to
// (high_u, high_v), all in samples, with errors up to the planes' margin. Of a window only resident coefficients are blended.
INLINE void plane_move(plane_t *plane, global const float *coefficients, const int4 extent, constant frame_t *frame, float way,
                       float across, float low_u, float high_u, float low_v, float high_v)
{
    const long row = extent.x, slice = row * extent.y;
    const int axis = frame->planes.axis, axis_u = axis == 0 ? 1 : 0, axis_v = axis == 2 ? 1 : 2;
    const float margin = frame->planes.margin;
    plane->along_u = axis == 0 ? row : 1;
    plane->along_v = axis == 2 ? row : slice;
    plane->across = axis == 0 ? 1 : axis == 1 ? row : slice;
    const int halo = extent.w;
    float t;
    plane->slice = locate_axis(across, &plane->t) + halo;
    const int u0 = locate_axis(low_u - margin, &t) + halo, u1 = locate_axis(high_u + margin, &t) + halo + WEIGHTS;
    const int v0 = locate_axis(low_v - margin, &t) + halo, v1 = locate_axis(high_v + margin, &t) + halo + TAPS;
    plane->u = MAX(u0, 0);
    plane->v = MAX(v0, 0);
    plane->columns = MIN(u1, WHOLE(frame, extent, axis_u)) - plane->u;
    plane->rows = MIN(v1, WHOLE(frame, extent, axis_v)) - plane->v;
    plane->usable = plane->columns <= PLANE_EDGE && plane->rows <= PLANE_EDGE && plane->columns > 0 && plane->rows > 0;
    // all but these follows from the whole volume, so that fractions are rounded alike in each window
    plane->first_column = MAX(STORED_FROM(frame, axis_u) - plane->u, 0);
    plane->first_row = MAX(STORED_FROM(frame, axis_v) - plane->v, 0);
    plane->columns = MIN(plane->columns, STORED_TO(frame, extent, axis_u) - plane->u);
    plane->rows = MIN(plane->rows, STORED_TO(frame, extent, axis_v) - plane->v);
    plane->sloped = 0;
    plane->from_u = cell_origin(halo - plane->u);
    plane->from_v = cell_origin(halo - plane->v);
    if (plane->usable) {
        plane_ahead(plane, coefficients, extent, frame, way);
        plane_blend(plane, coefficients, 0, plane->values);
    }
}

// The cells of LANES samples on a plane. Positions outside are moved inside: inactive lanes may have any value.
typedef struct { lane_indices_u at; real tu, tv; } plane_cell_t;

INLINE plane_cell_t plane_locate(const plane_t *plane, real u, real v)
{
    plane_cell_t c;
    u = MIN(MAX(GRID_POSITION(u, plane->from_u), (real)(0.0f)), (real)(PLANE_EDGE - WEIGHTS));
    v = MIN(MAX(GRID_POSITION(v, plane->from_v), (real)(0.0f)), (real)(PLANE_EDGE - TAPS));
    const mask column = locate_lanes(u, &c.tu), row = locate_lanes(v, &c.tv);
    c.at.all = row * PLANE_EDGE + column;
    return c;
}

// Sums over rows of the blend, weighted along v: column k holds the sum at tap k along u, for all lanes.
INLINE void plane_columns(const float *blend, const plane_cell_t *c, const real wv[TAPS], real columns[TAPS])
{
#if ROW == 4 && CHUNKS == 1 && LANES > 1
    real rows[4], transposed[4];
#define TAP_ROW(i) *(const row_at_t *)(p + c->at.each[i])
#define SUM_ROWS(i, each)                                                            \
    for (int j = 0; j < TAPS; ++j) {                                                 \
        const float *p = blend + j * PLANE_EDGE;                                     \
        const real taps = FOURTHS(TAP_ROW, i);                                       \
        rows[i] = j == 0 ? each(wv[j]) * taps : madd(each(wv[j]), taps, rows[i]);    \
    }
    _Pragma("unroll") SUM_ROWS(0, EACH_0)
    _Pragma("unroll") SUM_ROWS(1, EACH_1)
    _Pragma("unroll") SUM_ROWS(2, EACH_2)
    _Pragma("unroll") SUM_ROWS(3, EACH_3)
#undef SUM_ROWS
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
                rows[i] = madd(w[j].each[i], *(const row_at_t *)(p + j * PLANE_EDGE), rows[i]);
        }
        lane_taps(rows, taps + h * ROW);
    }
#pragma unroll
    for (int k = 0; k < TAPS; ++k)
        columns[k] = taps[k];
#endif
}

// LANES samples on a plane: data that the value saves for the gradient.
typedef struct { plane_cell_t cell; real wu[TAPS], wv[TAPS], columns[TAPS]; } plane_sample_t;

INLINE real plane_value(const plane_t *plane, plane_sample_t *s, real u, real v)
{
    s->cell = plane_locate(plane, u, v);
    lane_weights(s->cell.tu, s->wu);
    lane_weights(s->cell.tv, s->wv);
    plane_columns(plane->values, &s->cell, s->wv, s->columns);
    return lane_dot(s->columns, s->wu);
}

// Slopes along u and v and across the plane, per sample, where `plane_value` was before.
INLINE real3 plane_gradient(plane_t *plane, const plane_sample_t *s, global const float *coefficients)
{
    if (!plane->sloped) {
        plane_blend(plane, coefficients, 1, plane->slopes);
        plane->sloped = 1;
    }
    real slopes[TAPS], columns[TAPS];
    lane_slopes(s->cell.tu, slopes);
    const real du = GRID_SCALE * lane_dot(s->columns, slopes);
    lane_slopes(s->cell.tv, slopes);
    plane_columns(plane->values, &s->cell, slopes, columns);
    const real dv = GRID_SCALE * lane_dot(columns, s->wu);
    plane_columns(plane->slopes, &s->cell, s->wv, columns);
    const real across = GRID_SCALE * lane_dot(columns, s->wu);
    return real3_of(du, dv, across);
}
