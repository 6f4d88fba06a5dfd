// Kernels: from samples to B-spline coefficients, in place: along rows (x), along y or z, or along x and y together.
//
// For each pole z there is a causal recursion y[i] = x[i] + z y[i-1] and an anticausal one c[i] = z (c[i+1] - y[i]) (Unser,
// Aldroubi and Eden, 1991). Each needs a first value, which the host gives as a weighted sum of samples near the two ends. It
// follows from the matrix of eq. (11) that belongs to the boundary rule (prefilter.py, _starts), in one way for every rule and
// length.
//
// | what makes it fast                                                | where             |
// |-------------------------------------------------------------------|-------------------|
// | eight lines at once; CHAINS times as many side by side, since a recursion waits for its last product | filter_columns |
// | rows are transposed in blocks of eight, and stay so in between     | filter_rows       |
// | memory is prefetched AHEAD of its use                              | filter_columns    |
// | a slice stays in a processor's cache from x to y                   | prefilter_slices  |
//
// Set by the host: POLES, how many; POLE_VALUES; GAIN; ENDS, samples in each sum; CHAINS, vectors side by side.

#include "base/platform.cl"
#include "base/transpose.cl"

constant float poles[POLES] = POLE_VALUES;

// First values of the recursions: starts[pole][causal or anticausal][ENDS from the first, ENDS from the last];
// of these, head and tail count.
#define STARTS_PARAMS constant float *starts, const int head, const int tail
#define STARTS starts, head, tail

INLINE void add_to_starts(float8 start[2 * POLES], constant float *weight, float8 v)
{
#pragma unroll
    for (int p = 0; p < 2 * POLES; ++p)
        start[p] = madd((float8)(weight[p * 2 * ENDS]), v, start[p]);
}

// -- along y or z: lines lie side by side ---------------------------------------------------------------------

#define AHEAD 8   // samples of a line, each of which lies in a page of its own

// 8 * chains lines of `count` samples, stride apart. A recursion waits for its last product: several at once do not.
INLINE void filter_columns(global float *line, const int chains, const int count, const size_t stride, STARTS_PARAMS)
{
    float8 start[CHAINS][2 * POLES], v[CHAINS];
#define EACH_CHAIN _Pragma("unroll") for (int c = 0; c < chains; ++c)
#define LANES_AT(p) (*(global float8_at *)((p) + LANES * c))
    EACH_CHAIN
#pragma unroll
        for (int p = 0; p < 2 * POLES; ++p)
            start[c][p] = (float8)(0.0f);
    for (int i = 0; i < head; ++i)
        EACH_CHAIN add_to_starts(start[c], starts + i, LANES_AT(line + i * stride));
    for (int i = 0; i < tail; ++i)
        EACH_CHAIN add_to_starts(start[c], starts + ENDS + i, LANES_AT(line + (count - 1 - i) * stride));
    float gain = GAIN;
#pragma unroll 1
    for (int p = 0; p < POLES; ++p) {
        const float8 z = (float8)(poles[p]);
        EACH_CHAIN LANES_AT(line) = v[c] = start[c][2 * p];
        for (int i = 1; i < count; ++i) {
            global float *at = line + i * stride;
            for (int k = 0; k < chains; k += 2)
                PREFETCH(at + AHEAD * stride + k * LANES);
            EACH_CHAIN LANES_AT(at) = v[c] = madd(z, v[c], gain * LANES_AT(at));
        }
        EACH_CHAIN LANES_AT(line + (count - 1) * stride) = v[c] = start[c][2 * p + 1];
        for (int i = count - 2; i >= 0; --i) {
            global float *at = line + i * stride;
            EACH_CHAIN LANES_AT(at) = v[c] = madd(z, v[c], -z * LANES_AT(at));
        }
        gain = 1.0f;
    }
}

// Up to 8 * CHAINS lines, a multiple of 8.
INLINE void filter_some_columns(global float *line, const int lines, const int count, const size_t stride, STARTS_PARAMS)
{
    if (lines >= LANES * CHAINS)
        filter_columns(line, CHAINS, count, stride, STARTS);
    else
        for (int i = 0; i < lines; i += LANES)
            filter_columns(line + i, 1, count, stride, STARTS);
}

// `lines` lines side by side, 8 * CHAINS for a work-item along id 0; repeated along id 1, outer_stride apart.
kernel void prefilter_columns(global float *data, const ulong origin, const int count, const ulong stride,
                              const int lines, const ulong outer_stride, STARTS_PARAMS)
{
    const int first = get_global_id(0) * LANES * CHAINS;
    filter_some_columns(data + origin + get_global_id(1) * outer_stride + first, lines - first, count, stride, STARTS);
}

// -- along x: eight rows at once, in blocks of eight columns ----------------------------------------------------

// Between the two recursions a block of eight rows stays as it is, column i in the place of row i.
INLINE void keep_columns(float8 v[LANES], global float *block, const size_t pitch, const int rows)
{
    if (rows < LANES) {
        store_columns(v, block, pitch, rows);
        return;
    }
#pragma unroll
    for (int i = 0; i < LANES; ++i)
        *(global float8_at *)(block + i * pitch) = v[i];
}

INLINE void kept_columns(float8 v[LANES], global const float *block, const size_t pitch, const int rows)
{
    if (rows < LANES) {
        load_columns(v, block, pitch, rows);
        return;
    }
#pragma unroll
    for (int i = 0; i < LANES; ++i)
        v[i] = *(global const float8_at *)(block + i * pitch);
}

// One block of the causal recursion from y, and of the anticausal one from c. Past the row's end lies its halo, for
// which anything may be written.
INLINE float8 causal_block(float8 y, const float8 z, const float gain, const int first, global float *block,
                           const size_t pitch, const int rows)
{
    float8 v[LANES];
    load_columns(v, block, pitch, rows);
#pragma unroll
    for (int i = 0; i < LANES; ++i) {
        y = first && i == 0 ? y : madd(z, y, gain * v[i]);
        v[i] = y;
    }
    keep_columns(v, block, pitch, rows);
    return y;
}

// last: the block's column that is the last one of the row, or more.
INLINE float8 anticausal_block(float8 c, const float8 z, const int last, global float *block,
                               const size_t pitch, const int rows)
{
    float8 v[LANES];
    kept_columns(v, block, pitch, rows);
#pragma unroll
    for (int i = LANES - 1; i >= 0; --i) {
        c = i >= last ? c : madd(z, c, -z * v[i]);
        v[i] = c;
    }
    store_columns(v, block, pitch, rows);
    return c;
}

// `bands` times eight rows, or fewer than eight if `rows` says so.
INLINE void filter_rows(global float *line, const int bands, const int rows, const int count, const size_t pitch,
                        STARTS_PARAMS)
{
    float8 start[2][2 * POLES];
#define EACH_BAND _Pragma("unroll") for (int g = 0; g < bands; ++g)
#define BAND_AT(column) (line + g * LANES * pitch + (column))
    EACH_BAND
#pragma unroll
        for (int p = 0; p < 2 * POLES; ++p)
            start[g][p] = (float8)(0.0f);
    const int last_block = (count - 1) / LANES * LANES;
    for (int b = 0; b < count; b += LANES) {
        if (b >= head && b < (count - tail) / LANES * LANES)
            b = (count - tail) / LANES * LANES;
        EACH_BAND {
            float8 v[LANES];
            load_columns(v, BAND_AT(b), pitch, rows);
#pragma unroll
            for (int i = 0; i < LANES; ++i) {
                const int left = b + i, right = count - 1 - left;
                if (left < head)
                    add_to_starts(start[g], starts + left, v[i]);
                else if (right >= 0 && right < tail)
                    add_to_starts(start[g], starts + ENDS + right, v[i]);
            }
        }
    }
    float gain = GAIN;
#pragma unroll 1
    for (int p = 0; p < POLES; ++p) {
        const float8 z = (float8)(poles[p]);
        float8 v[2];
        EACH_BAND v[g] = causal_block(start[g][2 * p], z, gain, 1, BAND_AT(0), pitch, rows);
        for (int b = LANES; b < count; b += LANES)
            EACH_BAND v[g] = causal_block(v[g], z, gain, 0, BAND_AT(b), pitch, rows);
        EACH_BAND v[g] = anticausal_block(start[g][2 * p + 1], z, count - 1 - last_block, BAND_AT(last_block), pitch, rows);
        for (int b = last_block - LANES; b >= 0; b -= LANES)
            EACH_BAND v[g] = anticausal_block(v[g], z, LANES, BAND_AT(b), pitch, rows);
        gain = 1.0f;
    }
}

// Up to sixteen rows.
INLINE void filter_some_rows(global float *line, const int rows, const int count, const size_t pitch, STARTS_PARAMS)
{
    if (rows >= 2 * LANES)
        filter_rows(line, 2, LANES, count, pitch, STARTS);
    else
        for (int j = 0; j < rows; j += LANES)
            filter_rows(line + j * pitch, 1, MIN(LANES, rows - j), count, pitch, STARTS);
}

// Sixteen rows of `rows` along id 0, slices along id 1.
kernel void prefilter_rows(global float *data, const ulong origin, const int count, const ulong pitch, const int rows,
                           const ulong slice, STARTS_PARAMS)
{
    const int first = get_global_id(0) * 2 * LANES;
    filter_some_rows(data + origin + get_global_id(1) * slice + first * pitch, rows - first, count, pitch, STARTS);
}

// Along x and then along y, one slice a work-item along id 1: on a processor the slice stays in its cache in between.
// halo: of the rows, which begin at `origin`.
kernel void prefilter_slices(global float *data, const ulong origin, const int count, const ulong pitch, const int rows,
                             const ulong slice, const int halo, STARTS_PARAMS,
                             constant float *starts_y, const int head_y, const int tail_y)
{
    global float *first = data + origin + get_global_id(1) * slice;
    for (int j = 0; j < rows; j += 2 * LANES)
        filter_some_rows(first + j * pitch, rows - j, count, pitch, STARTS);
    for (int i = 0; i < pitch; i += LANES * CHAINS)
        filter_some_columns(first - halo + i, pitch - i, rows, pitch, starts_y, head_y, tail_y);
}
