// Code that is written once and runs for one ray or point, or for LANES of them at a time: `real` is a scalar or a vector.
//
// Set by the host: LANES: 1, 8, or 16 if registers are that wide (march.cl).

#include "base/platform.cl"

#if LANES == 1

typedef scalar real;
typedef int mask;
INLINE int any_lane(mask m) { return m; }
INLINE real to_real(mask i) { return (scalar)i; }
INLINE mask to_mask(real x) { return (int)x; }
INLINE scalar min_lane(real v) { return v; }

#else

typedef PASTE(SCALAR_TYPE, LANES) real;
typedef PASTE(int, LANES) mask;
INLINE real to_real(mask i) { return CONVERT(i, PASTE(SCALAR_TYPE, LANES)); }
INLINE mask to_mask(real x) { return CONVERT(x, PASTE(int, LANES)); }

// Halves of sixteen lanes, or the eight.
#if LANES == 16
#define HALVES(v, f) f((v).lo, (v).hi)
#else
#define HALVES(v, f) (v)
#endif
#define EITHER(a, b) ((a) | (b))

INLINE int any_lane(mask m)
{
    const int8 eight = HALVES(m, EITHER);
    const int4 four = eight.lo | eight.hi;
    const int2 two = four.lo | four.hi;
    return two.x | two.y;
}

INLINE scalar min_lane(real v)
{
    const scalar8 eight = HALVES(v, MIN);
    const scalar4 four = MIN(eight.lo, eight.hi);
    const scalar2 two = MIN(four.lo, four.hi);
    return MIN(two.x, two.y);
}

#endif

INLINE scalar max_lane(real v) { return -min_lane(-v); }

#if !SCALAR_DOUBLE   // a mask has the width of float
INLINE real choose(mask m, real yes, real no) { return m ? yes : no; }
#endif
INLINE mask choose_whole(mask m, mask yes, mask no) { return m ? yes : no; }
INLINE real magnitude(real a) { return a < 0.0f ? -a : a; }

#define NONE ((mask)(0))
#define NOWHERE ((real)(INFINITY))

// All lanes as an array, and back.
typedef union { real all; scalar each[LANES]; } lanes_u;
typedef union { mask all; int each[LANES]; } lane_masks_u;
// Indices, never negative: as unsigned numbers they take no instruction to become addresses.
typedef union { mask all; uint each[LANES]; } lane_indices_u;

typedef real real_at AT_ANY_ADDRESS;
