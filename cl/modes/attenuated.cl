// The maximum along the ray of values that fade with depth: near structures stand out, as in fog.
//
// A value counts from the smallest value of the transfer function up, times exp(-attenuation d), with d from 0 at the front of the
// volume's bounding sphere to 1 at its back.

#include "base/math.cl"
#include "frame.cl"

// t counts from the plane through the volume's centre, whose distance from the front is half of the sphere's diameter.
INLINE real faded(constant frame_t *frame, real value, real t)
{
    const real height = MAX(value - frame->transfer.low, (real)(0.0f));
    return height * exp_2(frame->mode.fade * MAX(t + frame->mode.front, (real)(0.0f)));
}

#define RANK(frame, value, t) faded(frame, value, t)
#define BEYOND(a, b) ((a) > (b))
#define FURTHEST(frame, low, high, t) (1.00001f * faded(frame, (real)(high), t))   // the error of exp_2 is up to 3e-7 either way
#define SHOWN(frame, rank) ((frame)->transfer.low + (rank))
#define PROMISE(low, high) (high)   // before it fades

#include "modes/extreme.cl"
