// Kernels: what matter leaves of light at the nodes of a coarse grid, the middles of its cells. The host side is shadow.py.
//
// Light of one direction is swept plane by plane, along lines in that direction through the nodes of the plane where it enters; what
// is left of it at a node is blended from the four lines around that. Lines never blend with each other, so that shadows stay sharp
// over any distance.
//
// Set by the host: LANES; SHEETS, whether matter is surfaces, or else all that is opaque; NAMES, whether values are names, which
// are not blended.

#include "base/math.cl"

// -- matter ----------------------------------------------------------------------------------------------------

#if SHEETS

// Of surfaces, `matter` has pairs of a value and the exponent of what crossing it leaves of light. `first` and `scale` are unused.
INLINE float exponents_up_to(global const float *matter, const int4 many, const float value)
{
    float sum = 0.0f;
    for (int k = 0; k < many.w; ++k)
        sum += value >= matter[2 * k] ? matter[2 * k + 1] : 0.0f;
    return sum;
}

#else

// The integral of the extinction over values up to `at`, which counts the nodes of `matter` from the second on: past the ends
// extinction is constant.
INLINE float exponents_up_to(global const float *matter, const int4 many, const float at)
{
    const int last = many.w - 2;
    const float inside = MIN(MAX(at + 1.0f, 0.0f), (float)(last + 1));
    const int i = MIN((int)inside, last);
    return madd(at + 1.0f - (float)i, matter[i + 1] - matter[i], matter[i]);
}

#endif

// The mean extinction of eight parts of each cell. In a part, values are taken as spread evenly from the smallest of its
// corners to the largest, so that thin layers of matter are not missed between them; equal ones have what is just below them, as
// the value of a jump has in pictures. `matrix` is from slopes between corners to those in the world, of surfaces, whose area in a
// volume it is: all of it, or what light of the direction `way` sees of it.
kernel void extinction(global const float *values, const int4 many, global const float *matter, const float first, const float scale,
                       constant float *matrix, const float4 way, global float *result)
{
    const int y = get_global_id(0), z = get_global_id(1);
#if SHEETS
    const float ways[3] = { way.x, way.y, way.z };
    const bool seen = way.x != 0.0f || way.y != 0.0f || way.z != 0.0f;
#endif
    const size_t row = 2 * many.x + 1, plane = row * (2 * many.y + 1);
    for (int x = 0; x < many.x; ++x) {
        float sum = 0.0f;
        for (int part = 0; part < 8; ++part) {
            global const float *at = values + (2 * z + (part >> 2)) * plane + (2 * y + (part >> 1 & 1)) * row + 2 * x + (part & 1);
            const float corners[8] = { at[0], at[1], at[row], at[row + 1], at[plane], at[plane + 1], at[plane + row], at[plane + row + 1] };
            float low = corners[0], high = low;
            for (int i = 1; i < 8; ++i) {
                low = MIN(low, corners[i]);
                high = MAX(high, corners[i]);
            }
#if SHEETS
            const float crossed = exponents_up_to(matter, many, high) - exponents_up_to(matter, many, low);
            if (crossed > 0.0f) {
                float slopes[3] = { 0.0f, 0.0f, 0.0f };
                for (int i = 0; i < 8; ++i)
                    for (int axis = 0; axis < 3; ++axis)
                        slopes[axis] += (i >> axis & 1 ? 0.25f : -0.25f) * corners[i];
                float squared = 0.0f, along = 0.0f;
                for (int axis = 0; axis < 3; ++axis) {
                    const float slope = madd(matrix[axis], slopes[0], madd(matrix[axis + 3], slopes[1], matrix[axis + 6] * slopes[2]));
                    squared = madd(slope, slope, squared);
                    along = madd(slope, ways[axis], along);
                }
                sum += crossed * (seen ? fabs(along) : sqrt(squared)) / (high - low);
            }
#elif NAMES
            for (int i = 0; i < 8; ++i) {
                const float name = (corners[i] - first) * scale;
                sum += 0.125f * (exponents_up_to(matter, many, name + 0.5f) - exponents_up_to(matter, many, name - 0.5f));
            }
#else
            const float top = (high - first) * scale, width = MAX((high - low) * scale, 1.0f);
            // past the ends by themselves: differences of large numbers have no digits left
            if (top - width >= (float)(many.w - 3))
                sum += matter[many.w - 1] - matter[many.w - 2];
            else if (top <= 0.0f)
                sum += matter[1] - matter[0];
            else
                sum += (exponents_up_to(matter, many, top) - exponents_up_to(matter, many, top - width)) / width;
#endif
        }
        result[((size_t)z * many.y + y) * many.x + x] = 0.125f * sum;
    }
}

// -- light -----------------------------------------------------------------------------------------------------

// Extinctions and results have rows of LANES zeros at both ends, and such rows around each plane; `strides` are from row to row, from
// plane to plane in the way of the light, and to the first number. A plane shifts lines by `shift` rows and numbers of a row.

#define BUNDLE 8   // vectors of a row that are computed at once

typedef struct { int whole; float rest; } shift_t;

INLINE shift_t shift_of(const float by)
{
    const int toward_zero = (int)by, whole = toward_zero - (by < (float)toward_zero);   // without a call of floor
    const shift_t shift = { whole, by - (float)whole };
    return shift;
}

INLINE real blend(global const float *at, const size_t row, const float across, const float down)
{
    const real near = *(global const real_at *)at, beside = *(global const real_at *)(at + 1);
    const real below = *(global const real_at *)(at + row), far = *(global const real_at *)(at + row + 1);
    const real upper = madd((real)(across), beside - near, near), lower = madd((real)(across), far - below, below);
    return madd((real)(down), lower - upper, upper);
}

// Keeps the planes between `from` and `to` at which lines that start at `first` are from low to high, or almost.
INLINE void narrow(const float first, const float shift, const float low, const float high, float *from, float *to)
{
    if (shift * shift < 1e-12f)
        return;
    const float a = (low - 1.0f - first) / shift, b = (high + 1.0f - first) / shift;
    *from = MAX(*from, MIN(a, b));
    *to = MIN(*to, MAX(a, b));
}

// What is left on lines at each plane. `many` are nodes of a row, rows and planes; `lines` the first line of a row, the first row of
// lines, and the strides of `left`. Of what lies behind a plane the next counts `faded`. `scale` is of the extinctions' exponents.
kernel void along_lines(global const float *extinctions, const int4 many, const int4 strides, const int4 lines, const float2 shift,
                        const float scale, const float faded, global float *left)
{
    const int number = BUNDLE * LANES * (int)get_global_id(0), row = get_global_id(1);
    real exponents[BUNDLE], before[BUNDLE];
    for (int i = 0; i < BUNDLE; ++i)
        exponents[i] = before[i] = (real)(0.0f);
    float from = 0.0f, to = (float)(many.z - 1);
    narrow((float)(lines.x + number), shift.x, (float)(-BUNDLE * LANES), (float)many.x, &from, &to);
    narrow((float)(lines.y + row), shift.y, -1.0f, (float)(many.y - 1), &from, &to);
    for (int n = (int)from; n < many.z && (float)n <= to; ++n) {
        const shift_t u = shift_of(n * shift.x), v = shift_of(n * shift.y);
        const int x = lines.x + number + u.whole, y = lines.y + row + v.whole;
        if (y < -1 || y >= many.y)
            continue;
        global const float *here_on = extinctions + strides.z + (long)n * strides.y + (long)y * strides.x + x;
        global float *left_on = left + (size_t)n * lines.w + (size_t)row * lines.z + number;
        const int past = MIN(BUNDLE, (many.x - x + LANES) / LANES);
        for (int i = x < 0 ? (-x - 1) / LANES : 0; i < past; ++i) {   // of the others nothing is read
            const real here = blend(here_on + i * LANES, strides.x, u.rest, v.rest);
            const real until = exponents[i];   // the plane before: matter would else lie in its own shadow
            exponents[i] = madd((real)(scale), before[i] + here, faded * until);
            before[i] = here;
            *(global real_at *)(left_on + i * LANES) = exp_2(-until);
        }
    }
}

// Adds the light that is left at nodes, times `weight`.
kernel void add_light(global const float *left, const int4 many, const int4 strides, const int4 lines, const float2 shift,
                      const float weight, global float *sums)
{
    const int y = get_global_id(0), n = get_global_id(1);
    const shift_t u = shift_of(-n * shift.x), v = shift_of(-n * shift.y);
    const int row = y - lines.y + v.whole;
    global const float *of_row = left + (size_t)n * lines.w + (size_t)row * lines.z + u.whole - lines.x;
    global float *sum = sums + strides.z + (long)n * strides.y + (long)y * strides.x;
    for (int x = 0; x < many.x; x += LANES) {
        global real_at *at = (global real_at *)(sum + x);
        *at = madd((real)(weight), blend(of_row + x, lines.z, u.rest, v.rest), *at);
    }
}
