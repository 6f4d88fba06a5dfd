// Points outside the volume's domain: mapped to an equivalent position, or assigned a value.
//
// Set by the host: DERIVATIVE, 0, 1 or 2; WITH_VALUE, whether each gradient follows its value, for points on a grid; EDGE, the
// distance from the outer samples to the domain's edge; FILL: 0, the boundary rule applies outside; 1, the result there is `fill`,
// NaN at positions that are not finite; 2, `fill` applies only to these, and is then also the constant of rules that have one;
// FUNCTIONS, how many are sampled together, with coefficients next to each other along x, and APART, how far those of one are apart;
// both are 1 if they are not set.

#include "spline/boundary.cl"
#include "spline/position.cl"

#ifndef FUNCTIONS
#define FUNCTIONS 1
#define APART 1
#endif

#if DERIVATIVE == 0
#define OF_EACH 1
#elif DERIVATIVE == 1
#define OF_EACH (WITH_VALUE + DIMENSIONS)
#else
#define OF_EACH (DIMENSIONS * DIMENSIONS)
#endif
#define COMPONENTS (FUNCTIONS * OF_EACH)   // results of a point

// A point outside: either moved inside, to be sampled there, or with a fixed value.
#define SAMPLED 0
#define FILLED 1
#define VALUED 2
#define MISSING 3

typedef struct { int x, y, z; } along_t;

INLINE int within_volume(position_t at, const int4 size)
{
#define WITHIN(axis) at.axis >= -(coord)(EDGE) && at.axis <= size.axis - 1 + (coord)(EDGE)
    return WITHIN(x) && WITHIN(y) && WITHIN(z);   // 0 for missing axes; NaN and infinities are outside
#undef WITHIN
}

// along: the signs of derivatives.
INLINE int bring(position_t *at, const int4 size, const int4 period, along_t *along)
{
    if (!(at->x - at->x == 0 && at->y - at->y == 0 && at->z - at->z == 0))
        return FILL == 2 ? FILLED : MISSING;
    if (FILL == 1)
        return FILLED;
#if BOUNDARY == CONSTANT
    if (!(at->x >= 0 && at->x <= size.x - 1 && at->y >= 0 && at->y <= size.y - 1 && at->z >= 0 && at->z <= size.z - 1))
        return VALUED;
#endif
    at->x = boundary_position(at->x, size.x, period.x, &along->x);
    at->y = boundary_position(at->y, size.y, period.y, &along->y);
    at->z = boundary_position(at->z, size.z, period.z, &along->z);
    return SAMPLED;
}

// given: `fill`, and the boundary rule's value. Gradients that follow values are those of a constant.
INLINE void value_into(const int kind, const scalar2 given, global scalar *result)
{
    for (int i = 0; i < COMPONENTS; ++i)
        if (WITH_VALUE)
            result[i] = kind == MISSING ? NAN : i > 0 ? 0 : kind == FILLED ? given.x : given.y;
        else
            result[i] = kind == MISSING ? NAN : kind == FILLED ? given.x : DERIVATIVE ? 0 : given.y;
}
