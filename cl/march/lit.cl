// How much of the light is left behind matter at a place: numbers at the nodes of a coarse grid (shadow.cl), blended.
//
// They follow the transfer function's in `table`: four for each node, SHADOWED times. Set by the host: SHADOWED.

#include "base/lanes.cl"
#include "base/vector.cl"
#include "march/sample.cl"

#define BEFORE_MATTER(k, light) (left[k] * (light))

INLINE float8 between(global const float4 *near, global const float4 *far, const float share)
{
    const float8 a = *(global const scalar8_at *)near, b = *(global const scalar8_at *)far;
    return madd(share, b - a, a);
}

// The shares of the ambient light and of each light at t, a little above the matter there, which would else lie in its own shadow.
INLINE void light_left(real *left, const sample_t *sample, const real3 normal, const mask flat, const real t, const mask active)
{
    constant lit_block *lit = &sample->frame->lit;
    const real3 p = matrix3(lit->to, at3(sample->ray->origin, sample->ray->direction, t)), above = matrix3(lit->above, normal);
    const real own[3] = { p.x, p.y, p.z }, aside[3] = { above.x, above.y, above.z };
    const size_t row = lit->nodes[0], plane = row * lit->nodes[1];
    lanes_u shares[3], numbers[4 * SHADOWED];
    lane_indices_u node = { NONE };
    for (int axis = 2; axis >= 0; --axis) {
        const real place = own[axis] + (choose(flat, (real)(0.0f), aside[axis]) + lit->shift[axis]);
        const real inside = MIN(MAX(place, (real)(0.0f)), (real)(lit->nodes[axis] - 1.0f));
        const mask before = MIN(to_mask(inside), (mask)(lit->nodes[axis] - 2));
        shares[axis].all = inside - to_real(before);
        node.all = node.all * lit->nodes[axis] + before;
    }
    const lane_masks_u wanted = { active };
    for (int k = 0; k < 4 * SHADOWED; ++k)
        numbers[k].all = (real)(1.0f);
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            for (int k = 0; k < 4 * SHADOWED; k += 4) {
                global const float4 *at = sample->table + lit->at + node.each[i] + (k ? plane * lit->nodes[2] : 0);
                const float8 front = between(at, at + row, shares[1].each[i]);
                const float8 back = between(at + plane, at + plane + row, shares[1].each[i]);
                const float8 both = madd(shares[2].each[i], back - front, front);   // nodes side by side
                const float4 blended = madd(shares[0].each[i], both.hi - both.lo, both.lo);
                numbers[k].each[i] = blended.x;
                numbers[k + 1].each[i] = blended.y;
                numbers[k + 2].each[i] = blended.z;
                numbers[k + 3].each[i] = blended.w;
            }
    for (int k = 0; k <= MOST_LIGHTS; ++k)
        left[k] = madd((real)(lit->weight[k]), numbers[lit->channel[k]].all - 1.0f, (real)(1.0f));
}
