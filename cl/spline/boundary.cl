// The boundary rule: moves any position to one whose taps are all stored (Boundary in boundary.py).
//
// Set by the host (build.py, boundary_defines): BOUNDARY, one of the numbers below; BOUNDARY_FOLDED and BOUNDARY_FOLD, whether
// index i equals -FOLD - i; BOUNDARY_PAD, samples of padding around the volume before the prefilter; BOUNDARY_REACH, samples past
// these from which on taps are constant.

#include "base/platform.cl"

#define REPEATED 0   // with a period, whose second half may be folded back
#define CONSTANT 1   // as REPEATED between the outer samples, constant elsewhere
#define OVERLAP 2    // repeated from outer sample to outer sample
#define ENDING 3     // the last coefficients continue, whatever they are

// n: samples along the axis. period: see Boundary.length. along: the sign that derivatives along the axis get.
INLINE coord boundary_position(coord x, const int n, const int period, int *along)
{
    const coord last = n - 1;
    (void)last;   // not every rule uses it
    *along = 1;
#if BOUNDARY == ENDING
    // past these ends all coefficients are the same, and the function repeats from one to the next
    const coord low = -(coord)(BOUNDARY_PAD + BOUNDARY_REACH), high = last - low;
    return x < low ? low - 1 + (x - floor(x)) : x > high ? high + (x - floor(x)) : x;
#elif BOUNDARY == CONSTANT
    return x;   // positions outside already have their value
#else
    // as in scipy.ndimage, to the last bit: it decides on which side of a jump a position lies
#if BOUNDARY == OVERLAP
    const coord length = MAX(last, (coord)1);
    x = x < 0 ? x + length * (floor(-x / length) + 1) : x > last ? x - length * floor(x / length) : x;
#elif BOUNDARY_FOLDED
    const coord middle = 0.5f * period;
    int folded = 0;
    if (x < 0) {
        x = x + period * floor(-x / period);
        folded = x > -middle;
        x = folded ? -x - BOUNDARY_FOLD : x + period;
    } else if (x > last) {
        x = x - period * floor(x / period);
        folded = x >= n;
        x = folded ? period - x - BOUNDARY_FOLD : x;
    }
    *along = folded ? -1 : 1;
#else
    x = x < 0 ? x + period * (floor(MAX(-1 - x, (coord)0) / period) + 1) : x > last ? x - period * floor(x / period) : x;
#endif
    return clamp(x, (coord)-1, (coord)n);   // so far out that rounding exceeds a period, it may be anything
#endif
}
