// The picture: a ray through each pixel, in samples, as in clvol's cl/march/camera.cl, and what a mode makes of its samples.
//
// Set by the page: MODE, one of COMPOSITE, SURFACES, EXTREME.

#define COMPOSITE 0
#define SURFACES 1
#define EXTREME 2

uniform vec3 origin, originU, originV, direction, directionU, directionV;   // of rays, at pixel (0, 0) and for each pixel
uniform float eyeAt;         // t of the eye is minus this times the direction's length
uniform bool orthographic;
uniform float pictureHeight;
uniform mat3 toWorld, toSlope;   // from samples to the world, in mean spacings; from gradients in samples to the world's
uniform vec3 low, high;      // the domain
uniform vec4 cuts[CUTS];     // planes in samples: normal, offset
uniform int cutCount;
uniform float cutLeast;      // less than this, in samples, is rounding
uniform vec4 planes;         // first, last, spacing; steps of oblique rays
uniform int planeCount, axis;
uniform sampler3D worth;     // of each brick of BRICK³ cells: how much there is to see
uniform float seenAbove;     // bricks of no more than this are skipped
uniform vec4 background;

uniform float perUnit, termination;   // composite
uniform bool faces;
uniform float isovalues[8];           // surfaces
uniform vec4 colors[8];
uniform int surfaces, cap;            // 0: no cap; 1: of values; 2: of one colour
uniform vec3 capColor;
uniform float sign_;                  // extremes: 1 for the maximum, -1

out vec4 pixel;

const float FAR = 1e30;

struct Ray { vec3 origin, direction, world; float enter, leave; bool cut; };

void clip(float from, float along, float low, float high, inout float enter, inout float leave)
{
    if (abs(along) < 1e-12) {
        if (from < low || from > high)
            enter = FAR;
        return;
    }
    float a = (low - from) / along, b = (high - from) / along;
    enter = max(enter, min(a, b));
    leave = min(leave, max(a, b));
}

Ray aimed()
{
    vec2 at = vec2(gl_FragCoord.x, pictureHeight - gl_FragCoord.y);
    Ray ray;
    ray.origin = origin + at.x * originU + at.y * originV;
    vec3 along = direction + at.x * directionU + at.y * directionV, world = toWorld * along;
    float stretch = length(world);
    ray.direction = along / stretch;
    ray.world = world / stretch;
    ray.enter = orthographic ? -FAR : -eyeAt * stretch;
    ray.leave = FAR;
    for (int i = 0; i < 3; ++i)
        clip(ray.origin[i], ray.direction[i], low[i], high[i], ray.enter, ray.leave);
    float uncut = ray.enter, end = ray.leave, least = cutLeast / length(ray.direction);
    for (int i = 0; i < cutCount; ++i) {
        float beyond = dot(ray.origin, cuts[i].xyz) - cuts[i].w, slope = dot(ray.direction, cuts[i].xyz);
        if (abs(slope) < 1e-12) {
            if (beyond > 0.0)
                ray.enter = FAR;
        } else if (slope > 0.0)
            ray.leave = min(ray.leave, -beyond / slope);
        else
            ray.enter = max(ray.enter, -beyond / slope);
    }
    if (ray.enter <= uncut + least)
        ray.enter = uncut;
    if (ray.leave >= end - least)
        ray.leave = end;
    ray.cut = ray.enter > uncut;
    return ray;
}

vec3 along(Ray ray, float t) { return ray.origin + t * ray.direction; }

// Where the samples lie: number n at x + n * y, for n from z to w.
vec4 sampled(Ray ray)
{
    float length_ = length(ray.direction), d = ray.direction[axis];
    bool oblique = abs(d) < 0.5 * length_;
    float stride = planes.w / length_;
    float step = oblique ? stride : planes.z / abs(d);
    float first = oblique ? ray.enter + 0.5 * stride : ((d > 0.0 ? planes.x : planes.y) - ray.origin[axis]) / d;
    float begin = oblique ? 0.0 : max(0.0, -floor((first - ray.enter) / step)), end = floor((ray.leave - first) / step);
    if (!oblique)
        end = min(end, float(planeCount) - 1.0);
    return end < begin ? vec4(0.5 * (ray.enter + ray.leave), 0.0, 0.0, 0.0) : vec4(first, step, begin, end);
}

// How much there is to see in the brick at p; `past`: t where the ray leaves it.
float worthAt(Ray ray, vec3 p, out float past)
{
    vec3 brick = floor((floor(p) + HALO) / BRICK), low = brick * BRICK - HALO;
    vec3 faces = mix(low, low + BRICK, vec3(greaterThan(ray.direction, vec3(0.0))));
    vec3 t = mix((faces - ray.origin) / ray.direction, vec3(FAR), vec3(lessThan(abs(ray.direction), vec3(1e-9))));
    past = min(t.x, min(t.y, t.z));
    return texelFetch(worth, ivec3(brick), 0).r;
}

#if MODE == COMPOSITE

const float FACE = 16.0;   // unit distances of matter as opaque as the face of a cut

float stopped(float opacity, float distance_)
{
    return opacity >= 1.0 ? 1.0 : 1.0 - exp2(distance_ * log2(max(1.0 - opacity, 1e-30)));
}

vec4 seen(Ray ray)
{
    vec4 s = sampled(ray);
    vec3 sum = vec3(0.0);
    float light = 1.0;
    if (ray.cut && faces) {
        vec4 color = classified(exact(along(ray, ray.enter)).w);
        float share = stopped(color.a, FACE);
        sum += share * color.rgb;
        light -= share;
    }
    for (float n = s.z; n <= s.w && light > termination;) {
        float t = s.x + n * s.y, past;
        vec3 p = along(ray, t);
        if (worthAt(ray, p, past) <= seenAbove) {
            n = s.y > 0.0 ? max(n + 1.0, ceil((past - s.x) / s.y - 1e-3)) : n + 1.0;
            continue;
        }
        float here = value(p);
        vec4 color = classified(here);
        if (color.a > 0.0) {
            float before = n == s.z ? max(t - ray.enter, 0.0) : 0.5 * s.y, behind = n == s.w ? max(ray.leave - t, 0.0) : 0.5 * s.y;
            float share = light * stopped(color.a, (before + behind) * perUnit);
#if SHADED
            color.rgb = lit(color.rgb, toSlope * gradient(p), here, ray.world);
#endif
            sum += share * color.rgb;
            light -= share;
        }
        n += 1.0;
    }
    return vec4(sum, 1.0 - light);
}

#elif MODE == SURFACES

const int TRIES = 14;

// The root between two samples on both sides of a value, by regula falsi that halves the value of an end that stays (Illinois).
float root(Ray ray, float near, float far, float sought)
{
    float a = exact(along(ray, near)).w - sought, b = exact(along(ray, far)).w - sought;
    if ((a < 0.0) == (b < 0.0))   // the sampler's rounding made them differ
        return abs(a) < abs(b) ? near : far;
    float t = far;
    int last = 0;
    for (int i = 0; i < TRIES; ++i) {
        t = near - a * (far - near) / (b - a);
        float c = exact(along(ray, t)).w - sought;
        if (abs(c) < 0.02)   // of 65535
            break;
        if ((c < 0.0) == (a < 0.0)) {
            near = t;
            a = c;
            b *= last == 1 ? 0.5 : 1.0;
            last = 1;
        } else {
            far = t;
            b = c;
            a *= last == 2 ? 0.5 : 1.0;
            last = 2;
        }
    }
    return t;
}

// Where the parabola through three equally spaced samples is nearest to a value that all of them lie on one side of, if the function
// is on the other side there; else the middle sample.
float beyond(Ray ray, float middle, float step, float a, float b, float c, float sought)
{
    a -= sought;
    b -= sought;
    c -= sought;
    float bend = a - 2.0 * b + c;
    bool one = (a < 0.0) == (b < 0.0) && (c < 0.0) == (b < 0.0) && abs(b) <= abs(a) && abs(b) <= abs(c) && bend != 0.0;
    if (!one || 16.0 * abs(b * bend) > 3.0 * (a - c) * (a - c))   // two thirds of what the parabola needs
        return middle;
    float t = middle + step * (a - c) / (2.0 * bend), there = exact(along(ray, t)).w - sought;
    return (there < 0.0) == (b < 0.0) ? middle : t;
}

void pass(Ray ray, float t, int k, inout vec3 sum, inout float light)
{
    float share = light * colors[k].a;
    sum += share * lit(asLight(colors[k].rgb), toSlope * exact(along(ray, t)).xyz, isovalues[k], ray.world);
    light -= share;
}

vec4 seen(Ray ray)
{
    vec3 sum = vec3(0.0);
    float light = 1.0, step = planes.w / length(ray.direction), last = ceil((ray.leave - ray.enter) / step);
    if (ray.cut && cap > 0) {
        float here = exact(along(ray, ray.enter)).w;
        if (here >= isovalues[0])
            return vec4(cap == 1 ? classified(here).rgb : asLight(capColor), 1.0);
    }
    float before = 0.0, earlier = 0.0;   // the values of the last two samples ...
    int known = 0;                       // ... of which there are so many
    for (float n = 0.0; n <= last && light > 1e-6;) {
        float t = min(ray.enter + n * step, ray.leave), past;
        vec3 p = along(ray, t);
        if (worthAt(ray, p, past) <= seenAbove) {
            known = 0;
            n = max(n + 1.0, ceil((past - ray.enter) / step - 1e-3));
            continue;
        }
        float middle = ray.enter + (n - 1.0) * step, here = value(p);
        if (known == 0 && n > 0.0) {
            before = value(along(ray, middle));
            known = 1;
        }
        for (int j = 0; j < surfaces && known > 0; ++j) {
            int k = here > before ? j : surfaces - 1 - j;
            if ((before < isovalues[k]) != (here < isovalues[k]))
                pass(ray, root(ray, middle, t, isovalues[k]), k, sum, light);
            else if (known > 1) {   // or both crossings lie between two samples
                float there = beyond(ray, middle, step, earlier, before, here, isovalues[k]);
                if (there != middle) {
                    pass(ray, root(ray, middle - (there < middle ? step : 0.0), there, isovalues[k]), k, sum, light);
                    pass(ray, root(ray, there, middle + (there < middle ? 0.0 : step), isovalues[k]), k, sum, light);
                }
            }
        }
        known = min(known + 1, 2);
        earlier = before;
        before = here;
        n += 1.0;
    }
    return vec4(sum, 1.0 - light);
}

#else

vec4 seen(Ray ray)
{
    vec4 s = sampled(ray);
    float best = -FAR;
    for (float n = s.z; n <= s.w;) {
        float past;
        vec3 p = along(ray, s.x + n * s.y);
        if (worthAt(ray, p, past) <= best) {
            n = s.y > 0.0 ? max(n + 1.0, ceil((past - s.x) / s.y - 1e-3)) : n + 1.0;
            continue;
        }
        best = max(best, sign_ * value(p));
        n += 1.0;
    }
    return vec4(classified(sign_ * best).rgb, 1.0);
}

#endif

void main()
{
    Ray ray = aimed();
    vec4 color = ray.enter <= ray.leave ? seen(ray) : vec4(0.0);
    if (background.a > 0.0)
        color = color.a > 0.0 ? vec4(asShown(clamp(color.rgb + (1.0 - color.a) * asLight(background.rgb), 0.0, 1.0)), 1.0) : background;
    else if (color.a > 0.0)   // premultiplied
        color.rgb = color.a * asShown(clamp(color.rgb / color.a, 0.0, 1.0));
    pixel = color;
}
