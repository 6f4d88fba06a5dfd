// The minimum along the ray.

#define BEYOND(a, b) ((a) < (b))
#define EXTREME(low, high) (low)
#define PROMISE(low, high) (-(low))

#include "modes/extreme.cl"
