// Value, gradient and Hessian of the reconstructed function at one point: by direct taps, or by
// trilinear fetches that each serve two taps an axis (Sigg and Hadwiger, GPU Gems 2, chapter 20).
//
// Set by the host: DIMENSIONS (2 or 3), PAIRED_VALUE and PAIRED_GRADIENT (whether pairs of
// weights, and of their derivatives, share their sign: Filter.pairable), besides what is included.

// Where a point lies among the stored coefficients: the first tap, and the fraction past it.
typedef struct { int x, y, z; float tx, ty, tz; } cell_t;

typedef struct { float x, y, z; } gradient_t;
typedef struct { float xx, yy, zz, xy, xz, yz; } hessian_t;

// Along z there is one slice of weight one in 2-D.
#if DIMENSIONS == 3
#define SLICE(unpack, t, w, flat) unpack(t, w)
#else
#define SLICE(unpack, t, w, flat) ((w)[0] = (flat))
#endif

#if SIDE == 1   // sums of two points at once: group.cl

// -- direct taps: rows of taps, blended along y and z, then dotted with the weights along x ----------------

INLINE float taps_value(VOLUME_PARAMS, cell_t c)
{
    const cursor_t first = cursor_at(VOLUME, c.x, c.y, c.z);
    float wy[WEIGHTS], wz[WEIGHTS], value = 0.0f;
    unpack_weights(c.ty, wy);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i)
        value += row_sum(blend_rows(VOLUME, first, i * ROW, wy, wz) * tap_weights(c.tx, i));
    return value;
}

INLINE gradient_t taps_gradient(VOLUME_PARAMS, cell_t c, float *value)
{
    const cursor_t first = cursor_at(VOLUME, c.x, c.y, c.z);
    float wy[WEIGHTS], wz[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS];
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    unpack_weights(c.ty, wy);
    unpack_slopes(c.ty, sy);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
    SLICE(unpack_slopes, c.tz, sz, 0.0f);
    *value = 0.0f;
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        const slopes_t s = blend_slopes(VOLUME, first, i * ROW, wy, sy, wz, sz);
        const row_t wx = tap_weights(c.tx, i);
        *value += row_sum(s.sum * wx);
        g.x += row_sum(s.sum * tap_slopes(c.tx, i));
        g.y += row_sum(s.sum_y * wx);
        g.z += row_sum(s.sum_z * wx);
    }
    return g;
}

INLINE hessian_t taps_hessian(VOLUME_PARAMS, cell_t c)
{
    const cursor_t first = cursor_at(VOLUME, c.x, c.y, c.z);
    float wy[WEIGHTS], wz[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS], by[WEIGHTS], bz[WEIGHTS];
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    unpack_weights(c.ty, wy);
    unpack_slopes(c.ty, sy);
    unpack_bends(c.ty, by);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
    SLICE(unpack_slopes, c.tz, sz, 0.0f);
    SLICE(unpack_bends, c.tz, bz, 0.0f);
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        cursor_t slice = first;
        row_t sum = (row_t)(0.0f), sum_y = sum, sum_z = sum, sum_yy = sum, sum_yz = sum, sum_zz = sum;
        UNROLL_TAPS
        for (int k = 0; k < SLICES; ++k, slice = next_slice(VOLUME, slice)) {
            row_t plane = (row_t)(0.0f), plane_y = plane, plane_yy = plane;
#pragma unroll
            for (int j = 0; j < TAPS; ++j) {
                const row_t row = fetch_row(VOLUME, slice, i * ROW, j);
                plane = madd(wy[j], row, plane);
                plane_y = madd(sy[j], row, plane_y);
                plane_yy = madd(by[j], row, plane_yy);
            }
            sum = madd(wz[k], plane, sum);
            sum_y = madd(wz[k], plane_y, sum_y);
            sum_yy = madd(wz[k], plane_yy, sum_yy);
            sum_z = madd(sz[k], plane, sum_z);
            sum_yz = madd(sz[k], plane_y, sum_yz);
            sum_zz = madd(bz[k], plane, sum_zz);
        }
        const row_t wx = tap_weights(c.tx, i), sx = tap_slopes(c.tx, i);
        h.xx += row_sum(sum * tap_bends(c.tx, i));
        h.yy += row_sum(sum_yy * wx);
        h.zz += row_sum(sum_zz * wx);
        h.xy += row_sum(sum_y * sx);
        h.xz += row_sum(sum_z * sx);
        h.yz += row_sum(sum_yz * wx);
    }
    return h;
}

// -- pairs of taps by trilinear fetches -------------------------------------------------------------------

#define PAIRS ((TAPS + 1) / 2)

// w0 f(0) + w1 f(1) = (w0 + w1) times a linear fetch at w1 / (w0 + w1), if the two share their sign.
INLINE void pair_up(const float w[WEIGHTS], float weight[PAIRS], float place[PAIRS])
{
#pragma unroll
    for (int i = 0; i < PAIRS; ++i) {
        const float second = 2 * i + 1 < TAPS ? w[2 * i + 1] : 0.0f;
        weight[i] = w[2 * i] + second;
        place[i] = 2 * i + (weight[i] != 0.0f ? second / weight[i] : 0.0f);
    }
}

INLINE void weight_pairs(float t, float weight[PAIRS], float place[PAIRS])
{
    float w[WEIGHTS];
    unpack_weights(t, w);
    pair_up(w, weight, place);
}

INLINE void slope_pairs(float t, float weight[PAIRS], float place[PAIRS])
{
    float w[WEIGHTS];
    unpack_slopes(t, w);
    pair_up(w, weight, place);
}

INLINE float pairs_blend(VOLUME_PARAMS, cell_t c, const float *ax, const float *ay, const float *az,
                         const float *px, const float *py, const float *pz)
{
    float sum = 0.0f;
#pragma unroll
    for (int k = 0; k < (DIMENSIONS == 3 ? PAIRS : 1); ++k) {
        float plane = 0.0f;
#pragma unroll
        for (int j = 0; j < PAIRS; ++j) {
            float line = 0.0f;
#pragma unroll
            for (int i = 0; i < PAIRS; ++i)
                line = madd(ax[i], fetch_linear(VOLUME, c.x + px[i], c.y + py[j], c.z + pz[k]), line);
            plane = madd(ay[j], line, plane);
        }
        sum = madd(az[k], plane, sum);
    }
    return sum;
}

INLINE float pairs_value(VOLUME_PARAMS, cell_t c)
{
    float ax[PAIRS], ay[PAIRS], az[PAIRS], px[PAIRS], py[PAIRS], pz[PAIRS];
    weight_pairs(c.tx, ax, px);
    weight_pairs(c.ty, ay, py);
#if DIMENSIONS == 3
    weight_pairs(c.tz, az, pz);
#else
    az[0] = 1.0f; pz[0] = 0.0f;
#endif
    return pairs_blend(VOLUME, c, ax, ay, az, px, py, pz);
}

INLINE gradient_t pairs_gradient(VOLUME_PARAMS, cell_t c, float *value)
{
    float ax[PAIRS], ay[PAIRS], az[PAIRS], px[PAIRS], py[PAIRS], pz[PAIRS], s[PAIRS], q[PAIRS];
    gradient_t g;
    weight_pairs(c.tx, ax, px);
    weight_pairs(c.ty, ay, py);
#if DIMENSIONS == 3
    weight_pairs(c.tz, az, pz);
    slope_pairs(c.tz, s, q);
    g.z = pairs_blend(VOLUME, c, ax, ay, s, px, py, q);
#else
    az[0] = 1.0f; pz[0] = 0.0f; g.z = 0.0f;
#endif
    *value = pairs_blend(VOLUME, c, ax, ay, az, px, py, pz);
    slope_pairs(c.tx, s, q);
    g.x = pairs_blend(VOLUME, c, s, ay, az, q, py, pz);
    slope_pairs(c.ty, s, q);
    g.y = pairs_blend(VOLUME, c, ax, s, az, px, q, pz);
    return g;
}

// -- what the kernels call -----------------------------------------------------------------------------------

INLINE float sample_value(VOLUME_PARAMS, cell_t c)
{
#if PAIRED_VALUE
    return pairs_value(VOLUME, c);
#else
    return taps_value(VOLUME, c);
#endif
}

// The gradient per stored coefficient, and the value beside it.
INLINE gradient_t sample_gradient(VOLUME_PARAMS, cell_t c, float *value)
{
#if PAIRED_VALUE && PAIRED_GRADIENT
    return pairs_gradient(VOLUME, c, value);
#else
    return taps_gradient(VOLUME, c, value);
#endif
}

#endif
