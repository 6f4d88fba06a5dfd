// What every kernel file needs first: how products are added, and the type of positions.

// One rounding where the device has it. Not fma(): PoCL 3.0 cannot compile it for float16.
#pragma OPENCL FP_CONTRACT ON
#define madd(a, b, c) ((a) * (b) + (c))

#if COORD_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double coord;
#else
typedef float coord;
#endif
