// Included first by every kernel file: differences between compilers and devices, and the types of numbers: `scalar`, of
// coefficients, weights and results, and `coord`, of positions.
//
// Set by the host: COORD_DOUBLE, whether positions are doubles; SCALAR_DOUBLE, if coefficients are.

// One rounding where the device has it. Not fma(): PoCL 3.0 cannot compile it for float16.
#pragma OPENCL FP_CONTRACT ON
#define madd(a, b, c) ((a) * (b) + (c))

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)

// Code that runs for every sample or tap is inlined and calls no built-in function: if PoCL does not know the CPU (3.0 on
// AMD's Zen 4, say) every vload, floor and select remains a call. Rarely needed code stays out of the loops.
// Kernels that are not optimised build in half the time if its functions stay apart, and give the same bits.
#ifdef __NO_INLINE__
#define INLINE static inline
#else
#define INLINE static inline __attribute__((always_inline))
#endif
#define OUT_OF_LINE static __attribute__((noinline))

// Of numbers, or of vectors element by element; the second where neither comparison holds.
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

#if COORD_DOUBLE || SCALAR_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

#if SCALAR_DOUBLE
#define SCALAR_TYPE double
#else
#define SCALAR_TYPE float
#endif
typedef SCALAR_TYPE scalar;
typedef PASTE(SCALAR_TYPE, 2) scalar2;
typedef PASTE(SCALAR_TYPE, 4) scalar4;
typedef PASTE(SCALAR_TYPE, 8) scalar8;

#if COORD_DOUBLE
typedef double coord;
#else
typedef float coord;
#endif

// A type at any address that is a multiple of four.
#define AT_ANY_ADDRESS __attribute__((aligned(4)))
typedef scalar4 scalar4_at AT_ANY_ADDRESS;
typedef scalar8 scalar8_at AT_ANY_ADDRESS;

// From one type of vector to another, without a call.
#ifdef __clang__
#define CONVERT(v, type) __builtin_convertvector(v, type)
#else
#define CONVERT(v, type) PASTE(convert_, type)(v)
#endif

// Prefetches the cache line of a global address, even one outside the allocation. (Clang takes only private pointers; on these
// CPUs all address spaces are the same.)
#if defined(__clang__) && defined(__x86_64__)
#define PREFETCH(address) __builtin_prefetch((const void *)(size_t)(address))
#else
#define PREFETCH(address)
#endif

// Loops over wide filters are not unrolled: with a thousand taps that takes some compilers minutes.
#if TAPS > 6
#define UNROLL_TAPS _Pragma("unroll 1")
#else
#define UNROLL_TAPS _Pragma("unroll")
#endif
