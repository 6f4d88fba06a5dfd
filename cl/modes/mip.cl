// The maximum along the ray.

#define BEYOND(a, b) ((a) > (b))
#define EXTREME(low, high) (high)
#define PROMISE(low, high) (high)

#include "modes/extreme.cl"
