// A head as in a CT scan, in Hounsfield units plus 1000 (air 0, water 1000): nested ellipsoids with soft
// edges, texture and noise. The object is that of the cube [-1, 1]^3 whatever the number of samples: x to the
// right, y to the back, z up.

// No built-in functions: where PoCL does not know the processor they remain calls, and 512^3 samples took a minute.
#ifdef __clang__
#define root __builtin_sqrtf
#else
#define root sqrt
#endif
#define low(a, b) ((a) < (b) ? (a) : (b))
#define high(a, b) ((a) > (b) ? (a) : (b))
#define INLINE static inline __attribute__((always_inline))

// A sine of arcs of parabolas, of period 2 pi.
INLINE float wave(float x)
{
    float t = x * 0.15915494f + 64.0f;   // positive
    t = t - (float)(int)t;
    return t < 0.5f ? 16.0f * t * (0.5f - t) : -16.0f * (t - 0.5f) * (1.0f - t);
}

INLINE float step_between(float from, float to, float x)
{
    float t = (x - from) / (to - from);
    t = t < 0.0f ? 0.0f : t > 1.0f ? 1.0f : t;
    return t * t * (3.0f - 2.0f * t);
}

INLINE float blend(float a, float b, float share)
{
    return a + (b - a) * share;
}

// The approximate depth inside an ellipsoid at (cx, cy, cz) with the radii a, b and c a point is.
INLINE float ellipsoid(float x, float y, float z, float cx, float cy, float cz, float a, float b, float c)
{
    const float u = (x - cx) / a, v = (y - cy) / b, w = (z - cz) / c;
    return (1.0f - root(u * u + v * v + w * w)) * low(a, low(b, c));
}

// The depth inside a round bar about (cx, cy) with radius r.
INLINE float bar(float x, float y, float cx, float cy, float r)
{
    return r - root((x - cx) * (x - cx) + (y - cy) * (y - cy));
}

// 0 outside, 1 inside, over the width of the scanner's blur.
INLINE float inside(float depth)
{
    return step_between(-0.012f, 0.012f, depth);
}

INLINE uint scramble(uint x)
{
    x = (x ^ (x >> 16)) * 0x7feb352dU;
    x = (x ^ (x >> 15)) * 0x846ca68bU;
    return x ^ (x >> 16);
}

// Nearly normal, of variance one.
INLINE float noise(uint voxel)
{
    const uint a = scramble(voxel), b = scramble(a + 0x9e3779b9U);
    return ((a & 0xffff) + (a >> 16) + (b & 0xffff) + (b >> 16) - 2.0f * 65535.0f) / (65535.0f * 0.57735f);
}

INLINE float head(float x, float y, float z)
{
    const float side = x < 0.0f ? -x : x;   // for what comes in pairs
    float skin = ellipsoid(x, y, z, 0.0f, 0.02f, 0.12f, 0.62f, 0.78f, 0.80f);
    skin = high(skin, ellipsoid(x, y, z, 0.0f, -0.25f, -0.42f, 0.42f, 0.48f, 0.42f));        // the jaw
    skin = high(skin, low(bar(x, y, 0.0f, 0.15f, 0.36f), 0.2f - z));                         // the neck
    skin = high(skin, ellipsoid(x, y, z, 0.0f, -0.78f, -0.12f, 0.10f, 0.14f, 0.17f));        // the nose
    skin = high(skin, ellipsoid(side, y, z, 0.63f, 0.05f, 0.0f, 0.06f, 0.12f, 0.18f));       // the ears
    const float outer = ellipsoid(x, y, z, 0.0f, 0.03f, 0.14f, 0.56f, 0.71f, 0.73f);
    const float brain = ellipsoid(x, y, z, 0.0f, 0.03f, 0.14f, 0.49f, 0.64f, 0.66f);
    const float socket = ellipsoid(side, y, z, 0.22f, -0.62f, 0.05f, 0.14f, 0.20f, 0.12f);
    const float nostril = ellipsoid(x, y, z, 0.0f, -0.68f, -0.14f, 0.08f, 0.22f, 0.14f);
    const float jaw = low(ellipsoid(x, y, z, 0.0f, -0.27f, -0.42f, 0.34f, 0.40f, 0.34f),
                          -ellipsoid(x, y, z, 0.0f, -0.12f, -0.46f, 0.27f, 0.42f, 0.40f));
    const float spine = low(bar(x, y, 0.0f, 0.25f, 0.10f), low(-0.35f - z, 0.04f - 0.03f * wave(40.0f * z)));
    float bone = high(low(outer, -brain), high(jaw, spine));
    bone = low(bone, -high(socket, nostril));
    bone -= 0.010f * (1.0f + wave(9.0f * x + 4.0f * wave(7.0f * z)) * wave(8.0f * y));       // its thickness varies

    // the brain: folds at its rim, ventricles, a vessel
    const float folds = wave(26.0f * x + 3.0f * wave(13.0f * y)) * wave(24.0f * y + 3.0f * wave(15.0f * z))
                      * wave(25.0f * z + 3.0f * wave(14.0f * x));
    const float rim = 1.0f - step_between(0.0f, 0.16f, brain);
    const float ventricle = ellipsoid(side, y, z, 0.09f, 0.0f, 0.22f, 0.05f, 0.26f, 0.10f);
    const float vessel = bar(x, y, 0.20f * wave(5.0f * z), 0.15f * wave(6.0f * z + 1.6f) - 0.25f, 0.018f);
    float value = 1035.0f + 12.0f * folds * rim + 8.0f * wave(5.0f * x) * wave(6.0f * y) * wave(4.0f * z);
    value = blend(value, 1005.0f, high(inside(ventricle), 0.8f * rim * step_between(0.35f, 0.6f, folds)) * inside(brain));
    value = blend(value, 1300.0f, inside(low(vessel, brain)));

    const float muscle = 1060.0f + 30.0f * wave(21.0f * x + 2.0f * wave(9.0f * z)) * wave(17.0f * z);
    value = blend(muscle, value, inside(outer));
    value = blend(950.0f, value, step_between(0.02f, 0.05f, skin));                          // fat under the skin
    value = blend(value, 1020.0f, inside(socket));
    value = blend(value, 2000.0f + 250.0f * wave(31.0f * x) * wave(29.0f * y) * wave(33.0f * z), inside(bone));
    value = blend(value, 40.0f, inside(nostril - 0.02f));
    return value * inside(skin);
}

// Slices from `first` on of a cube of `n` samples; values times `scale`.
kernel void scene(global VALUE *result, const int n, const int first, const float scale, const float least, const float most)
{
    const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
    const float unit = 2.0f / n, corner = 0.5f * unit - 1.0f;
    float value = head(x * unit + corner, y * unit + corner, (z + first) * unit + corner);
    value = scale * (value + 12.0f * noise((uint)x + (uint)n * ((uint)y + (uint)n * (uint)(z + first))));
    result[x + (size_t)n * (y + (size_t)n * z)] = (VALUE)(value < least ? least : value > most ? most : value);
}
