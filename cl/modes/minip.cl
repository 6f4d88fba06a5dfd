// The minimum along the ray.

#define RANK(frame, value, t) (value)
#define BEYOND(a, b) ((a) < (b))
#define FURTHEST(frame, low, high, t) ((real)(low))
#define SHOWN(frame, rank) (rank)
#define PROMISE(low, high) (-(low))

#include "modes/extreme.cl"
