// Kernel: weighted sums of samples along one axis of an array; each sum has its own samples and weights.
//
// | what makes it fast                                                       | where       |
// |--------------------------------------------------------------------------|-------------|
// | WIDTH lines side by side: one weight serves WIDTH samples                 | sum_lines   |
// | they are first brought together, however far apart they lie in the array: | bring_lines |
// | neighbouring sums take much the same samples, which are then in the cache |             |
//
// Set by the host: ALONG, whether lines run along the last axis; WIDTH, a multiple of 8; FAR, whether samples are so far from zero that
// each sum is that of their differences from one of them. The host also computes the samples of each sum, and their weights (reduce.py).

#include "base/platform.cl"

#define VECTORS (WIDTH / 8)

#if FAR // for each sum the sample that others differ little from, and the sum of the weights
#define FAR_PARAMETERS , global const int *restrict middles, global const scalar *restrict totals
#define FAR_ARGUMENTS , middles, totals
#else
#define FAR_PARAMETERS
#define FAR_ARGUMENTS
#endif

// `count` lines of `n` samples, side by side, and a row of their outside values.
INLINE void bring_lines(global scalar *restrict lines, global const scalar *restrict data, const size_t next_line,
                        const size_t next_sample, const int n, const int count, const scalar outside)
{
    for (int i = 0; i < n; ++i) {
        global scalar *row = lines + (size_t)i * WIDTH;
        global const scalar *from = data + i * next_sample;
        if (count == WIDTH && next_line == 1)
            for (int v = 0; v < VECTORS; ++v)
                *(global scalar8_at *)(row + 8 * v) = *(global const scalar8_at *)(from + 8 * v);
        else
            for (int r = 0; r < WIDTH; ++r)
                row[r] = from[MIN(r, count - 1) * next_line];
    }
    for (int r = 0; r < WIDTH; ++r)
        lines[(size_t)n * WIDTH + r] = outside;
}

INLINE void sum_lines(global scalar *restrict result, const size_t next_line, const size_t next_sample, const int sums,
                      const int count, global const scalar *restrict lines, const int taps, global const int *restrict places,
                      global const scalar *restrict weights FAR_PARAMETERS)
{
    for (int j = 0; j < sums; ++j) {
        scalar8 sum[VECTORS];
#pragma unroll
        for (int v = 0; v < VECTORS; ++v)
            sum[v] = (scalar8)(0);
#if FAR
        global const scalar *middle = lines + (size_t)middles[j] * WIDTH;
#endif
        for (size_t t = (size_t)j * taps; t < (size_t)(j + 1) * taps; ++t) {
            global const scalar *row = lines + (size_t)places[t] * WIDTH;
            const scalar8 weight = (scalar8)(weights[t]);
#pragma unroll
            for (int v = 0; v < VECTORS; ++v) {
                scalar8 value = *(global const scalar8_at *)(row + 8 * v);
#if FAR
                value -= *(global const scalar8_at *)(middle + 8 * v);
#endif
                sum[v] = madd(weight, value, sum[v]);
            }
        }
#if FAR
        const scalar8 total = (scalar8)(totals[j]);
#pragma unroll
        for (int v = 0; v < VECTORS; ++v)
            sum[v] = madd(total, *(global const scalar8_at *)(middle + 8 * v), sum[v]);
#endif
        global scalar *to = result + j * next_sample;
        if (count == WIDTH && next_line == 1) {
#pragma unroll
            for (int v = 0; v < VECTORS; ++v)
                *(global scalar8_at *)(to + 8 * v) = sum[v];
        } else {
            union { scalar8 all[VECTORS]; scalar each[WIDTH]; } out;
#pragma unroll
            for (int v = 0; v < VECTORS; ++v)
                out.all[v] = sum[v];
            for (int r = 0; r < count; ++r)
                to[r * next_line] = out.each[r];
        }
    }
}

// An array [outer][n][inner] becomes [outer][sums][inner]. A work-item takes some of `units` in turn, each WIDTH lines that lie
// side by side; if they run ALONG the last axis, inner is 1 and they are WIDTH of the outer ones.
//
// scratch: (n + 1) WIDTH numbers for each work-item. Place n stands for `outside`. `results` may be `data` where sums == n: lines
// are brought together before any of their sums is written.
kernel void sum_along_axis(global const scalar *data, const int outer, const int n, const int inner, const int sums,
                           const int taps, global const int *restrict places, global const scalar *restrict weights,
                           const scalar outside, const int first, const int units, global scalar *restrict scratch,
                           global scalar *results FAR_PARAMETERS)
{
    const size_t item = get_global_id(0), items = get_global_size(0);
    global scalar *lines = scratch + item * (size_t)(n + 1) * WIDTH;
    const int end = first + (size_t)units * (item + 1) / items;
    for (int unit = first + (size_t)units * item / items; unit < end; ++unit) {
#if ALONG
        const size_t line = (size_t)unit * WIDTH;
        const int count = MIN(WIDTH, (int)(outer - line));
        bring_lines(lines, data + line * n, n, 1, n, count, outside);
        sum_lines(results + line * sums, sums, 1, sums, count, lines, taps, places, weights FAR_ARGUMENTS);
#else
        const int across = (inner + WIDTH - 1) / WIDTH;
        const size_t slab = unit / across, line = (size_t)(unit % across) * WIDTH;
        const int count = MIN(WIDTH, (int)(inner - line));
        bring_lines(lines, data + slab * n * inner + line, 1, inner, n, count, outside);
        sum_lines(results + slab * sums * inner + line, 1, inner, sums, count, lines, taps, places, weights FAR_ARGUMENTS);
#endif
    }
}
