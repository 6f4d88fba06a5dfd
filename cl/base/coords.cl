// LANES positions along an axis, of the type of positions, which may be double: two halves, lanes 0 to 3 and lanes 4 to 7, since
// eight doubles are wider than most registers.

#include "base/lanes.cl"

#if LANES == 8

#if COORD_DOUBLE
typedef double4 coord4;
typedef long4 mask4;
typedef long mask_each;
#else
typedef float4 coord4;
typedef int4 mask4;
typedef int mask_each;
#endif
typedef struct { coord4 low, high; } coords_t;

#if COORD_DOUBLE
#define COORDS(v) CONVERT(v, double4)
#else
#define COORDS(v) CONVERT(v, float4)
#endif

INLINE coords_t to_coords(mask i)
{
    const coords_t c = { COORDS(i.lo), COORDS(i.hi) };
    return c;
}

#endif
