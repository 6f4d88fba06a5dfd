// The function: values and gradients from coefficients in a 3-D texture, in units of their 16 bits.
//
// Set by the page: FILTER, the degree of the B-spline: 3, 1, or 0 for the nearest sample; NAMES, whether values are labels.
// Two bytes a coefficient, high and low: interpolation is linear, so that it may be done on both, also by samplers of 8-bit textures,
// which all devices have.

precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler3D;

uniform sampler3D coefficients;
uniform vec3 extent;      // texels; the first sample is texel HALO
uniform bool byHand;      // whether weights are float32's everywhere, not the sampler's (8 bits on GPUs)

const float HALO = 2.0;

float unpacked(vec2 bytes) { return 255.0 * (256.0 * bytes.r + bytes.g); }

float at(ivec3 texel) { return unpacked(texelFetch(coefficients, texel, 0).rg); }

vec2 between(float x, float y, float z) { return texture(coefficients, (vec3(x, y, z) + HALO + 0.5) / extent).rg; }

#if FILTER == 3

vec4 weights(float f)
{
    float s = 1.0 - f;
    return vec4(s * s * s, 4.0 + 3.0 * f * f * (f - 2.0), 4.0 + 3.0 * s * s * (s - 2.0), f * f * f) / 6.0;
}

vec4 slopes(float f)
{
    float s = 1.0 - f;
    return 0.5 * vec4(-s * s, f * (3.0 * f - 4.0), s * (1.0 + 3.0 * f), f * f);
}

// Gradient (xyz) and value (w) from 64 texels.
vec4 exact(vec3 p)
{
    vec3 cell = floor(p), f = p - cell;
    ivec3 first = ivec3(cell + HALO - 1.0);
    vec4 wx = weights(f.x), wy = weights(f.y), wz = weights(f.z), dx = slopes(f.x), dy = slopes(f.y), dz = slopes(f.z), sum = vec4(0.0);
    for (int z = 0; z < 4; ++z)
        for (int y = 0; y < 4; ++y) {
            ivec3 i = first + ivec3(0, y, z);
            vec4 row = vec4(at(i), at(i + ivec3(1, 0, 0)), at(i + ivec3(2, 0, 0)), at(i + ivec3(3, 0, 0)));
            float value = dot(wx, row);
            sum += vec4(dot(dx, row) * wy[y] * wz[z], value * dy[y] * wz[z], value * wy[y] * dz[z], value * wy[y] * wz[z]);
        }
    return sum;
}

// Where to fetch pairs of texels so that the sampler's linear weights are those of the pair, and the upper pair's weight.
void pairs(vec3 p, out vec3 low, out vec3 high, out vec3 upper)
{
    vec3 cell = floor(p), f = p - cell, s = 1.0 - f;
    vec3 second = 4.0 + 3.0 * f * f * (f - 2.0), fourth = f * f * f, lower = s * s * s + second;
    upper = 1.0 - lower / 6.0;
    low = cell - 1.0 + second / lower;
    high = cell + 1.0 + fourth / (6.0 * upper);
}

// The same of slopes: the lower pair's weight is minus the upper one's.
void slopePairs(vec3 p, out vec3 low, out vec3 high, out vec3 upper)
{
    vec3 cell = floor(p), f = p - cell, s = 1.0 - f;
    vec3 second = f * (3.0 * f - 4.0), fourth = f * f;
    upper = 0.5 * (s * (1.0 + 3.0 * f) + fourth);
    low = cell - 1.0 + second / (second - s * s);
    high = cell + 1.0 + 0.5 * fourth / upper;
}

vec2 row(float x, float y, vec3 low, vec3 high, vec3 upper)
{
    return mix(between(x, y, low.z), between(x, y, high.z), upper.z);
}

// Eight fetches.
float value(vec3 p)
{
    if (byHand)
        return exact(p).w;
    vec3 low, high, u;
    pairs(p, low, high, u);
    vec2 near = mix(row(low.x, low.y, low, high, u), row(low.x, high.y, low, high, u), u.y);
    vec2 far = mix(row(high.x, low.y, low, high, u), row(high.x, high.y, low, high, u), u.y);
    return unpacked(mix(near, far, u.x));
}

// Three times eight fetches.
vec3 gradient(vec3 p)
{
    if (byHand)
        return exact(p).xyz;
    vec3 a, b, u, c, d, v;
    pairs(p, a, b, u);
    slopePairs(p, c, d, v);
    vec2 x = mix(row(d.x, a.y, a, b, u) - row(c.x, a.y, a, b, u), row(d.x, b.y, a, b, u) - row(c.x, b.y, a, b, u), u.y);
    vec2 y = mix(row(a.x, d.y, a, b, u) - row(a.x, c.y, a, b, u), row(b.x, d.y, a, b, u) - row(b.x, c.y, a, b, u), u.x);
    vec2 z = mix(mix(between(a.x, a.y, d.z) - between(a.x, a.y, c.z), between(a.x, b.y, d.z) - between(a.x, b.y, c.z), u.y),
                 mix(between(b.x, a.y, d.z) - between(b.x, a.y, c.z), between(b.x, b.y, d.z) - between(b.x, b.y, c.z), u.y), u.x);
    return v * vec3(unpacked(x), unpacked(y), unpacked(z));
}

#elif FILTER == 1

vec4 exact(vec3 p)
{
    vec3 cell = floor(p), f = p - cell;
    ivec3 i = ivec3(cell + HALO);
    vec4 low = vec4(at(i), at(i + ivec3(1, 0, 0)), at(i + ivec3(0, 1, 0)), at(i + ivec3(1, 1, 0)));
    vec4 high = vec4(at(i + ivec3(0, 0, 1)), at(i + ivec3(1, 0, 1)), at(i + ivec3(0, 1, 1)), at(i + ivec3(1, 1, 1)));
    vec4 plane = mix(low, high, f.z), rise = high - low;
    vec2 line = mix(plane.xz, plane.yw, f.x);
    return vec4(mix(plane.y - plane.x, plane.w - plane.z, f.y), line.y - line.x,
                mix(mix(rise.x, rise.y, f.x), mix(rise.z, rise.w, f.x), f.y), mix(line.x, line.y, f.y));
}

float value(vec3 p) { return byHand ? exact(p).w : unpacked(between(p.x, p.y, p.z)); }

vec3 gradient(vec3 p) { return exact(p).xyz; }

#else

float nearest(vec3 p) { return at(ivec3(floor(p + 0.5) + HALO)); }

float value(vec3 p) { return nearest(p); }

bool solid(float name);

// Differences of the samples around; of labels, which are names, of what is solid.
vec3 gradient(vec3 p)
{
    vec3 sum = vec3(0.0);
    for (int z = -1; z <= 1; ++z)
        for (int y = -1; y <= 1; ++y)
            for (int x = -1; x <= 1; ++x) {
                vec3 step = vec3(x, y, z), weight = 2.0 - step * step;
#if NAMES
                if (solid(nearest(p + step)))
                    sum += step * weight.x * weight.y * weight.z;
#else
                if (dot(step, step) == 1.0)
                    sum += 0.5 * step * nearest(p + step);
#endif
            }
    return sum;
}

vec4 exact(vec3 p) { return vec4(gradient(p), nearest(p)); }

#endif
