// The maximum along the ray.

#define RANK(frame, value, t) (value)
#define BEYOND(a, b) ((a) > (b))
#define FURTHEST(frame, low, high, t) ((real)(high))
#define SHOWN(frame, rank) (rank)
#define PROMISE(low, high) (high)

#include "modes/extreme.cl"
