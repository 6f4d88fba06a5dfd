/* What OpenCL C has built in and our kernels call, for programs that clang compiles for the host: see runtime.py. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

typedef float float3 __attribute__((ext_vector_type(3)));
typedef float float4 __attribute__((ext_vector_type(4)));
typedef float float8 __attribute__((ext_vector_type(8)));
typedef double double4 __attribute__((ext_vector_type(4)));
typedef int int4 __attribute__((ext_vector_type(4)));
typedef int int8 __attribute__((ext_vector_type(8)));
typedef int int16 __attribute__((ext_vector_type(16)));
typedef float float16 __attribute__((ext_vector_type(16)));
typedef double double8 __attribute__((ext_vector_type(8)));

#define NAMED(name) __asm__(name)

size_t clvol_place[3], clvol_sizes[3];   /* of the work-item that runs */

size_t get_global_id(unsigned axis) NAMED("_Z13get_global_idj");
size_t get_global_id(unsigned axis) { return clvol_place[axis]; }
size_t get_global_size(unsigned axis) NAMED("_Z15get_global_sizej");
size_t get_global_size(unsigned axis) { return clvol_sizes[axis]; }

#define OF_ONE(name, mangled_float, mangled_double)                          \
    float cl_##name##_f(float x) NAMED(mangled_float);                      \
    float cl_##name##_f(float x) { return name##f(x); }                     \
    double cl_##name##_d(double x) NAMED(mangled_double);                   \
    double cl_##name##_d(double x) { return name(x); }
OF_ONE(sqrt, "_Z4sqrtf", "_Z4sqrtd")
OF_ONE(floor, "_Z5floorf", "_Z5floord")
OF_ONE(fabs, "_Z4fabsf", "_Z4fabsd")

float clamp_f(float x, float low, float high) NAMED("_Z5clampfff");
float clamp_f(float x, float low, float high) { return fminf(fmaxf(x, low), high); }
double clamp_d(double x, double low, double high) NAMED("_Z5clampddd");
double clamp_d(double x, double low, double high) { return fmin(fmax(x, low), high); }

#define FLOOR(type, lanes, mangled)                    \
    type cl_floor_##type(type x) NAMED(mangled);       \
    type cl_floor_##type(type x)                       \
    {                                                  \
        for (int i = 0; i < lanes; ++i)                \
            x[i] = (float)floor(x[i]);                 \
        return x;                                      \
    }
FLOOR(float4, 4, "_Z5floorDv4_f")
FLOOR(float8, 8, "_Z5floorDv8_f")

float3 pow3(float3 x, float3 y) NAMED("_Z3powDv3_fS_");
float3 pow3(float3 x, float3 y) { return (float3){powf(x.x, y.x), powf(x.y, y.y), powf(x.z, y.z)}; }

void store3(float3 v, size_t at, float *to) NAMED("_Z7vstore3Dv3_fmPU8CLglobalf");
void store3(float3 v, size_t at, float *to) { to[3 * at] = v.x, to[3 * at + 1] = v.y, to[3 * at + 2] = v.z; }

/* -- images: float, three-dimensional, read by one of two samplers ------------------------------------------------- */

typedef struct { float *texels; int size[3]; } image_t;

/* The bits of a sampler, as clang gives them. */
enum { NORMALIZED = 1, LINEAR = 32 };

void *sampler_of(int bits) NAMED("__translate_sampler_initializer");
void *sampler_of(int bits) { return (void *)(intptr_t)(bits | 1 << 16); }

static float texel(const image_t *image, long x, long y, long z)
{
    const long at[3] = {x, y, z};
    size_t place = 0;
    for (int axis = 2; axis >= 0; --axis) {
        const long last = image->size[axis] - 1;
        place = place * image->size[axis] + (at[axis] < 0 ? 0 : at[axis] > last ? last : at[axis]);
    }
    return image->texels[place];
}

float4 read_at(image_t *image, void *sampler, float4 at) NAMED("_Z11read_imagef14ocl_image3d_ro11ocl_samplerDv4_f");
float4 read_at(image_t *image, void *sampler, float4 at)
{
    if ((intptr_t)sampler & NORMALIZED || !((intptr_t)sampler & LINEAR))
        abort();
    long base[3];
    float past[3], sum = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const float u = fminf(fmaxf(at[axis] - 0.5f, -1.0f), (float)image->size[axis]);
        base[axis] = (long)floorf(u);
        past[axis] = u - base[axis];
    }
    for (int i = 0; i < 8; ++i) {
        const float w = (i & 1 ? past[0] : 1 - past[0]) * (i & 2 ? past[1] : 1 - past[1]) * (i & 4 ? past[2] : 1 - past[2]);
        sum += w * texel(image, base[0] + (i & 1), base[1] + (i >> 1 & 1), base[2] + (i >> 2));
    }
    return (float4){sum, 0, 0, 1};
}

float4 read_texel(image_t *image, void *sampler, int4 at) NAMED("_Z11read_imagef14ocl_image3d_ro11ocl_samplerDv4_i");
float4 read_texel(image_t *image, void *sampler, int4 at) { return (float4){texel(image, at.x, at.y, at.z), 0, 0, 1}; }

float4 read_plain(image_t *image, int4 at) NAMED("_Z11read_imagef14ocl_image3d_roDv4_i");
float4 read_plain(image_t *image, int4 at)
{
    for (int axis = 0; axis < 3; ++axis)
        if (at[axis] < 0 || at[axis] >= image->size[axis])
            abort();
    return read_texel(image, 0, at);
}

/* -- launches ---------------------------------------------------------------------------------------------------- */

void clvol_launch(void (*run)(void *, void *), void *table, void *image, const size_t size[3], const size_t first[3])
{
    for (int axis = 0; axis < 3; ++axis)
        clvol_sizes[axis] = size[axis];
    for (size_t z = 0; z < size[2]; ++z)
        for (size_t y = 0; y < size[1]; ++y)
            for (size_t x = 0; x < size[0]; ++x) {
                clvol_place[0] = first[0] + x;
                clvol_place[1] = first[1] + y;
                clvol_place[2] = first[2] + z;
                run(table, image);
            }
}
