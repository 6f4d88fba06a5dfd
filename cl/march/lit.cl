// How much of the light is left behind matter at a place: numbers at the nodes of a coarse grid (shadow.cl), blended.
//
// They follow the transfer function's in `table`: SHADOWED times four for each node. Set by the host: SHADOWED.

#include "base/lanes.cl"
#include "base/vector.cl"
#include "march/sample.cl"

#define MOST_LIGHTS 4
#define BEFORE_MATTER(k, light) (left[k] * (light))

typedef struct { float4 rows[SHADOWED]; } node_t;

INLINE node_t between(const node_t a, const node_t b, const float share)
{
    node_t result;
    for (int i = 0; i < SHADOWED; ++i)
        result.rows[i] = madd(share, b.rows[i] - a.rows[i], a.rows[i]);
    return result;
}

// At a place that counts nodes, and lies between them.
INLINE node_t node_at(constant lit_block *lit, global const float4 *table, const float x, const float y, const float z)
{
    const int i = MIN((int)x, lit->nodes[0] - 2), j = MIN((int)y, lit->nodes[1] - 2), k = MIN((int)z, lit->nodes[2] - 2);
    const size_t row = lit->nodes[0], plane = row * lit->nodes[1];
    global const node_t *at = (global const node_t *)(table + lit->at) + k * plane + j * row + i;
    const float across = x - (float)i, down = y - (float)j, deep = z - (float)k;
    const node_t front = between(between(at[0], at[1], across), between(at[row], at[row + 1], across), down);
    at += plane;
    return between(front, between(between(at[0], at[1], across), between(at[row], at[row + 1], across), down), deep);
}

// The shares of the ambient light and of each light at t, a little above the matter there, which would else lie in its own shadow.
INLINE void light_left(real *left, const sample_t *sample, const real3 normal, const mask flat, const real t, const mask active)
{
    constant lit_block *lit = &sample->frame->lit;
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t), above = matrix3(lit->above, normal);
    const real own[3] = { p.x, p.y, p.z }, aside[3] = { above.x, above.y, above.z };
    lanes_u at[3], numbers[4 * SHADOWED];
    for (int axis = 0; axis < 3; ++axis) {
        const real place = madd(own[axis], lit->scale[axis], choose(flat, (real)(0.0f), aside[axis]) + lit->shift[axis]);
        at[axis].all = MIN(MAX(place, (real)(0.0f)), (real)(lit->nodes[axis] - 1.0f));
    }
    const lane_masks_u wanted = { active };
    for (int k = 0; k < 4 * SHADOWED; ++k)
        numbers[k].all = (real)(1.0f);
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i]) {
            const node_t node = node_at(lit, sample->table, at[0].each[i], at[1].each[i], at[2].each[i]);
            for (int row = 0; row < SHADOWED; ++row) {
                numbers[4 * row].each[i] = node.rows[row].x;
                numbers[4 * row + 1].each[i] = node.rows[row].y;
                numbers[4 * row + 2].each[i] = node.rows[row].z;
                numbers[4 * row + 3].each[i] = node.rows[row].w;
            }
        }
    for (int k = 0; k <= MOST_LIGHTS; ++k)
        left[k] = madd((real)(lit->weight[k]), numbers[lit->channel[k]].all - 1.0f, (real)(1.0f));
}
