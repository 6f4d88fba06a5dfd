// What lies past the edge: the index rule of the current boundary (Boundary in boundary.py), on a grid of GRID_SCALE
// coefficients a sample.
//
// Set by the host (build.py, boundary_defines): BOUNDARY_PERIODIC, BOUNDARY_FOLDED and BOUNDARY_FOLD: index i equals
// -FOLD - i.

#include "base/platform.cl"

#define MISSING INT_MIN

// Where coefficient i is stored on an axis that stores those from -halo to end - 1, or MISSING if it is zero. period: see
// Boundary.length.
INLINE int boundary_index(int i, int halo, int end, int period)
{
#if BOUNDARY_PERIODIC
    const int p = period * GRID_SCALE;
    i -= p * (int)floor((float)i / (float)p);
    i = i < 0 ? i + p : (i >= p ? i - p : i);   // the float quotient may be off by one
#if BOUNDARY_FOLDED
    const int folded = p - BOUNDARY_FOLD * GRID_SCALE - i;
    i = folded < i ? folded : i;
#endif
    return i;
#else
    return (i >= -halo && i < end) ? i : MISSING;
#endif
}

// A position in samples, brought to within one period of the axis. Where the rule does not repeat, it is clipped to where
// all taps are zero. The result is finite.
INLINE coord boundary_position(coord x, int n, int period)
{
#if BOUNDARY_PERIODIC
    // clamped, for so far out that rounding exceeds a period the difference may be anything
    return (x >= (coord)(-n) && x <= (coord)(2 * n)) ? x
        : clamp(x - period * floor(x / period), (coord)0, (coord)period);
#else
    return clamp(x, (coord)(-2 * TAPS - 2), (coord)(n + 2 * TAPS + 2));
#endif
}
