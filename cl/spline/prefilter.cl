// Kernels: from samples to B-spline coefficients, in place: along rows (x), along y or z, or along x and y together.
//
// The poles are undone in stages of ORDER, 1 or 2: a causal recursion y[i] = x[i] + a1 y[i-1] + a2 y[i-2] and an anticausal one,
// c[i] = y[i] + a1 c[i+1] + a2 c[i+2] (Unser, Aldroubi and Eden, 1991 and 1993). A single pole z has c[i] = z (c[i+1] - y[i])
// instead. Complex poles, which smoothing brings, come in conjugate pairs, so that a stage of two is real. Each recursion needs
// its first ORDER values, for which the host passes weights of samples near the two ends. They follow from the matrix of eq. (11)
// for the boundary rule (prefilter.py, _plan), in the same way for every rule and length. Rows, which are first, are multiplied by
// the gains of all axes.
//
// | what makes it fast                                                | where             |
// |-------------------------------------------------------------------|-------------------|
// | eight lines at once; CHAINS times as many side by side, since a recursion waits for its last product | filter_columns |
// | two poles a stage: memory is traversed half as often              | causal, anticausal |
// | rows are transposed in blocks of eight, and stay so in between     | filter_rows       |
// | memory is prefetched AHEAD of its use                              | filter_columns    |
// | a slice stays in a processor's cache from x to y                   | prefilter_slices  |
// | first values at one end take no sample near the other, if SPLIT    | add_to_starts     |
//
// Set by the host: ORDER; STAGES, their number; CHAINS, vectors side by side; SPLIT, whether the sums for causal recursions need
// only samples near the first one, and those for anticausal ones near the last one: lines are long and do not wrap.

#include "base/platform.cl"
#include "base/transpose.cl"

#define SUMS (2 * ORDER * STAGES)

// Of the lines of one axis: {a1, a2} of each stage, the gain, then the weights of the first values,
// [stage][causal, then anticausal][ORDER, from the end on][ends from the first, ends from the last]; head and tail of them count.
#define PLAN_PARAMS constant scalar *plan, const int ends, const int head, const int tail
#define PLAN plan, ends, head, tail

typedef struct {
    scalar8 a1, a2;
} stage_t;

INLINE stage_t stage_of(constant scalar *plan, const int s)
{
    const stage_t stage = { (scalar8)(plan[2 * s]), (scalar8)(plan[2 * s + 1]) };
    return stage;
}

// end: 0 for a sample near the first one, 1 near the last.
INLINE void add_to_starts(scalar8 start[SUMS], constant scalar *plan, const int ends, const int end, const int place, scalar8 v)
{
    constant scalar *weight = plan + 2 * STAGES + 1 + end * ends + place;
#pragma unroll
    for (int p = 0; p < SUMS; ++p)
        if (!SPLIT || p / ORDER % 2 == end)
            start[p] = madd((scalar8)(weight[p * 2 * ends]), v, start[p]);
}

// One step of a recursion, from its last value and the one before.
INLINE scalar8 causal(scalar8 *last, scalar8 *before, const stage_t stage, const scalar8 x)
{
#if ORDER == 2
    const scalar8 next = madd(stage.a1, *last, madd(stage.a2, *before, x));
    *before = *last;
    return *last = next;
#else
    return *last = madd(stage.a1, *last, x);
#endif
}

INLINE scalar8 anticausal(scalar8 *last, scalar8 *before, const stage_t stage, const scalar8 y)
{
#if ORDER == 2
    return causal(last, before, stage, y);
#else
    return *last = madd(stage.a1, *last, -stage.a1 * y);
#endif
}

// A first value replaces the result of the recursion.
INLINE scalar8 started(scalar8 *last, scalar8 *before, const scalar8 first)
{
    *before = *last;
    return *last = first;
}

// -- along y or z: lines lie side by side ---------------------------------------------------------------------

#define AHEAD 8   // samples of a line, each of which lies in a page of its own

// 8 * chains lines of `count` samples, stride apart. A recursion waits for its last product: several at once do not.
INLINE void filter_columns(global scalar *line, const int chains, const int count, const size_t stride, PLAN_PARAMS)
{
    scalar8 start[CHAINS][SUMS], last[CHAINS], before[CHAINS];
#define EACH_CHAIN _Pragma("unroll") for (int c = 0; c < CHAINS; ++c) if (c < chains)   // counted by a constant, to be unrolled
#define LANES_AT(p) (*(global scalar8_at *)((p) + LANES * c))
    EACH_CHAIN
#pragma unroll
        for (int p = 0; p < SUMS; ++p)
            start[c][p] = (scalar8)(0.0f);
    for (int i = 0; i < head; ++i)
        EACH_CHAIN add_to_starts(start[c], plan, ends, 0, i, LANES_AT(line + i * stride));
    for (int i = 0; i < tail; ++i)
        EACH_CHAIN add_to_starts(start[c], plan, ends, 1, i, LANES_AT(line + (count - 1 - i) * stride));
#pragma unroll 1
    for (int s = 0; s < STAGES; ++s) {
        const stage_t stage = stage_of(plan, s);
        const int from = 2 * ORDER * s, back = from + ORDER;
        EACH_CHAIN LANES_AT(line) = last[c] = start[c][from];
#if ORDER == 2
        if (count > 1)
            EACH_CHAIN LANES_AT(line + stride) = started(last + c, before + c, start[c][from + 1]);
#endif
        for (int i = ORDER; i < count; ++i) {
            global scalar *at = line + i * stride;
            for (int k = 0; k < chains; k += 2)
                PREFETCH(at + AHEAD * stride + k * LANES);
            EACH_CHAIN LANES_AT(at) = causal(last + c, before + c, stage, LANES_AT(at));
        }
        EACH_CHAIN LANES_AT(line + (count - 1) * stride) = last[c] = start[c][back];
#if ORDER == 2
        if (count > 1)
            EACH_CHAIN LANES_AT(line + (count - 2) * stride) = started(last + c, before + c, start[c][back + 1]);
#endif
        for (int i = count - 1 - ORDER; i >= 0; --i) {
            global scalar *at = line + i * stride;
            EACH_CHAIN LANES_AT(at) = anticausal(last + c, before + c, stage, LANES_AT(at));
        }
    }
}

// Up to 8 * CHAINS lines, a multiple of 8.
INLINE void filter_some_columns(global scalar *line, const int lines, const int count, const size_t stride, PLAN_PARAMS)
{
    if (lines >= LANES * CHAINS)
        filter_columns(line, CHAINS, count, stride, PLAN);
    else
        for (int i = 0; i < lines; i += LANES)
            filter_columns(line + i, 1, count, stride, PLAN);
}

// `lines` lines side by side, 8 * CHAINS for a work-item along id 0; repeated along id 1, outer_stride apart.
kernel void prefilter_columns(global scalar *data, const ulong origin, const int count, const ulong stride,
                              const int lines, const ulong outer_stride, PLAN_PARAMS)
{
    const int first = get_global_id(0) * LANES * CHAINS;
    filter_some_columns(data + origin + get_global_id(1) * outer_stride + first, lines - first, count, stride, PLAN);
}

// -- along x: eight rows at once, in blocks of eight columns ----------------------------------------------------

// Between the two recursions a block of eight rows stays as it is, column i in the place of row i.
INLINE void keep_columns(scalar8 v[LANES], global scalar *block, const size_t pitch, const int rows)
{
    if (rows < LANES) {
        store_columns(v, block, pitch, rows);
        return;
    }
#pragma unroll
    for (int i = 0; i < LANES; ++i)
        *(global scalar8_at *)(block + i * pitch) = v[i];
}

INLINE void kept_columns(scalar8 v[LANES], global const scalar *block, const size_t pitch, const int rows)
{
    if (rows < LANES) {
        load_columns(v, block, pitch, rows);
        return;
    }
#pragma unroll
    for (int i = 0; i < LANES; ++i)
        v[i] = *(global const scalar8_at *)(block + i * pitch);
}

// One block of a recursion that continues from `state`. first, last: the block's column that is the first or the last one of the
// row; it may lie in another block. The recursion's first values stand from there on. Past the row's end lies its halo, for
// which anything may be written.
INLINE void causal_block(scalar8 state[2], const stage_t stage, const scalar gain, const scalar8 *given, const int first,
                         global scalar *block, const size_t pitch, const int rows)
{
    scalar8 v[LANES];
    load_columns(v, block, pitch, rows);
#pragma unroll
    for (int i = 0; i < LANES; ++i)
        v[i] = i < first + ORDER ? started(state, state + 1, given[i - first]) : causal(state, state + 1, stage, gain * v[i]);
    keep_columns(v, block, pitch, rows);
}

INLINE void anticausal_block(scalar8 state[2], const stage_t stage, const scalar8 *given, const int last,
                             global scalar *block, const size_t pitch, const int rows)
{
    scalar8 v[LANES];
    kept_columns(v, block, pitch, rows);
#pragma unroll
    for (int i = LANES - 1; i >= 0; --i)
        v[i] = i > last - ORDER ? started(state, state + 1, given[MAX(last - i, 0)]) : anticausal(state, state + 1, stage, v[i]);
    store_columns(v, block, pitch, rows);
}

// `bands` times eight rows, or fewer than eight if `rows` says so.
INLINE void filter_rows(global scalar *line, const int bands, const int rows, const int count, const size_t pitch,
                        PLAN_PARAMS)
{
    scalar8 start[2][SUMS];
#define EACH_BAND _Pragma("unroll") for (int g = 0; g < 2; ++g) if (g < bands)
#define BAND_AT(column) (line + g * LANES * pitch + (column))
    EACH_BAND
#pragma unroll
        for (int p = 0; p < SUMS; ++p)
            start[g][p] = (scalar8)(0.0f);
    const int last_block = (count - 1) / LANES * LANES;
    for (int b = 0; b < count; b += LANES) {
        if (b >= head && b < (count - tail) / LANES * LANES)
            b = (count - tail) / LANES * LANES;
        EACH_BAND {
            scalar8 v[LANES];
            load_columns(v, BAND_AT(b), pitch, rows);
#pragma unroll
            for (int i = 0; i < LANES; ++i) {
                const int left = b + i, right = count - 1 - left;
                if (left < head)
                    add_to_starts(start[g], plan, ends, 0, left, v[i]);
                else if (right >= 0 && right < tail)
                    add_to_starts(start[g], plan, ends, 1, right, v[i]);
            }
        }
    }
#pragma unroll 1
    for (int s = 0; s < STAGES; ++s) {
        const stage_t stage = stage_of(plan, s);
        const scalar gain = s ? 1.0f : plan[2 * STAGES];
        const int from = 2 * ORDER * s, back = from + ORDER;
        scalar8 v[2][2];
        EACH_BAND causal_block(v[g], stage, gain, start[g] + from, 0, BAND_AT(0), pitch, rows);
        for (int b = LANES; b < count; b += LANES)
            EACH_BAND causal_block(v[g], stage, gain, start[g] + from, -ORDER, BAND_AT(b), pitch, rows);
        EACH_BAND anticausal_block(v[g], stage, start[g] + back, count - 1 - last_block, BAND_AT(last_block), pitch, rows);
        int b = last_block - LANES;
#if ORDER == 2   // its first values may lie in two blocks
        if (b >= 0) {
            EACH_BAND anticausal_block(v[g], stage, start[g] + back, count - 1 - b, BAND_AT(b), pitch, rows);
            b -= LANES;
        }
#endif
        for (; b >= 0; b -= LANES)
            EACH_BAND anticausal_block(v[g], stage, start[g] + back, LANES + ORDER, BAND_AT(b), pitch, rows);
    }
}

// Up to sixteen rows.
INLINE void filter_some_rows(global scalar *line, const int rows, const int count, const size_t pitch, PLAN_PARAMS)
{
    if (rows >= 2 * LANES)
        filter_rows(line, 2, LANES, count, pitch, PLAN);
    else
        for (int j = 0; j < rows; j += LANES)
            filter_rows(line + j * pitch, 1, MIN(LANES, rows - j), count, pitch, PLAN);
}

// Sixteen rows of `rows` along id 0, slices along id 1.
kernel void prefilter_rows(global scalar *data, const ulong origin, const int count, const ulong pitch, const int rows,
                           const ulong slice, PLAN_PARAMS)
{
    const int first = get_global_id(0) * 2 * LANES;
    filter_some_rows(data + origin + get_global_id(1) * slice + first * pitch, rows - first, count, pitch, PLAN);
}

// Along x and then along y, one slice a work-item along id 1: on a processor the slice stays in its cache in between.
// halo: of the rows, which begin at `origin`.
kernel void prefilter_slices(global scalar *data, const ulong origin, const int count, const ulong pitch, const int rows,
                             const ulong slice, const int halo, PLAN_PARAMS,
                             constant scalar *plan_y, const int ends_y, const int head_y, const int tail_y)
{
    global scalar *first = data + origin + get_global_id(1) * slice;
    for (int j = 0; j < rows; j += 2 * LANES)
        filter_some_rows(first + j * pitch, rows - j, count, pitch, PLAN);
    for (int i = 0; i < (int)pitch; i += LANES * CHAINS)
        filter_some_columns(first - halo + i, pitch - i, rows, pitch, plan_y, ends_y, head_y, tail_y);
}
