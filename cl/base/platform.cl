// What every kernel file needs first: how products are added, and the type of positions.

// One rounding where the device has it. Not fma(): PoCL 3.0 cannot compile it for float16.
#pragma OPENCL FP_CONTRACT ON
#define madd(a, b, c) ((a) * (b) + (c))

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)

// From one type of vector to another, without a call.
#ifdef __clang__
#define CONVERT(v, type) __builtin_convertvector(v, type)
#else
#define CONVERT(v, type) PASTE(convert_, type)(v)
#endif

// Asks memory for the line of a global address, be it past what is stored. (Clang takes private pointers only; on these
// processors all are alike.)
#if defined(__clang__) && defined(__x86_64__)
#define ASK_FOR(address) __builtin_prefetch((const void *)(size_t)(address))
#else
#define ASK_FOR(address)
#endif

// What runs once a sample or once a tap is inlined, and calls no built-in function: where PoCL does not
// know the processor (3.0 on AMD's Zen 4, say) it leaves every vload, floor and select a call.
#define INLINE static inline __attribute__((always_inline))

#if COORD_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double coord;
#else
typedef float coord;
#endif

INLINE int at_most(int i, int most)
{
    return i < most ? i : most;
}

// The greatest whole number below, for what fits an int.
INLINE coord whole_below(coord x)
{
    const coord i = (coord)(int)x;
    return x < i ? i - 1 : i;
}
