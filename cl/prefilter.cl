// Kernel: from samples to B-spline coefficients along one axis, in place, eight lines a work-item.
//
// For each pole z a causal recursion y[i] = x[i] + z y[i-1] and an anticausal one
// c[i] = z (c[i+1] - y[i]) (Unser, Aldroubi and Eden, 1991). Both need a first value. The host gives
// it as a weighted sum of samples near the two ends, worked out from the matrix of eq. (11) that
// belongs to the boundary rule (spline.py, prefilter_starts): one way for every rule and length.
//
// Set by the host: POLES (how many), POLE_VALUES, GAIN, ENDS (samples in each sum), LANE_STRIDE_ONE
// (the eight lines lie side by side).

#include "common.cl"

constant float poles[POLES] = POLE_VALUES;

typedef float8 lanes_t __attribute__((aligned(4)));

INLINE float8 load_lanes(global const float *p, const ulong lane_stride)
{
#if LANE_STRIDE_ONE
    return *(global const lanes_t *)p;
#else
    const size_t s = lane_stride;
    return (float8)(p[0], p[s], p[2 * s], p[3 * s], p[4 * s], p[5 * s], p[6 * s], p[7 * s]);
#endif
}

INLINE void store_lanes(float8 v, global float *p, const ulong lane_stride, const int lanes)
{
#if LANE_STRIDE_ONE
    *(global lanes_t *)p = v;
#else
    union { float8 v; float each[8]; } u;
    u.v = v;
    if (lanes == 8) {
#pragma unroll
        for (int i = 0; i < 8; ++i)
            p[i * lane_stride] = u.each[i];
    } else {
        for (int i = 0; i < lanes; ++i)
            p[i * lane_stride] = u.each[i];
    }
#endif
}

// count samples a line, stride apart; groups of eight lines along id 0, then lines along id 1.
// starts[pole][causal or anticausal][ENDS from the first, ENDS from the last]; of these, head and tail count.
kernel void prefilter(global float *data, const ulong origin, const int count, const ulong stride,
                      const ulong lane_stride, const int lines, const ulong outer_stride,
                      constant float *starts, const int head, const int tail)
{
    const int group = get_global_id(0);
    // the last group reads past its lines, into what the host keeps behind them, and does not write there
    const int first = group * 8, lanes = min(8, lines - first);
    global float *line = data + origin + first * lane_stride + get_global_id(1) * outer_stride;

    float8 start[POLES][2];
    for (int p = 0; p < 2 * POLES; ++p)
        start[p >> 1][p & 1] = (float8)(0.0f);
    for (int i = 0; i < head; ++i) {
        const float8 v = load_lanes(line + i * stride, lane_stride);
        for (int p = 0; p < 2 * POLES; ++p)
            start[p >> 1][p & 1] = madd((float8)(starts[p * 2 * ENDS + i]), v, start[p >> 1][p & 1]);
    }
    for (int i = 0; i < tail; ++i) {
        const float8 v = load_lanes(line + (count - 1 - i) * stride, lane_stride);
        for (int p = 0; p < 2 * POLES; ++p)
            start[p >> 1][p & 1] = madd((float8)(starts[p * 2 * ENDS + ENDS + i]), v, start[p >> 1][p & 1]);
    }
    float gain = GAIN;
    for (int p = 0; p < POLES; ++p) {
        const float8 z = (float8)(poles[p]);
        float8 y = start[p][0];
        store_lanes(y, line, lane_stride, lanes);
        for (int i = 1; i < count; ++i) {
            y = madd(z, y, gain * load_lanes(line + i * stride, lane_stride));
            store_lanes(y, line + i * stride, lane_stride, lanes);
        }
        float8 c = start[p][1];
        store_lanes(c, line + (count - 1) * stride, lane_stride, lanes);
        for (int i = count - 2; i >= 0; --i) {
            c = z * (c - load_lanes(line + i * stride, lane_stride));
            store_lanes(c, line + i * stride, lane_stride, lanes);
        }
        gain = 1.0f;
    }
}
