// The greatest value along the ray.

#define BEYOND(a, b) ((a) > (b))

#include "modes/extreme.cl"
