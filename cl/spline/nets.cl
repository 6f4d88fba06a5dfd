// Kernels: where the vertices of surface nets lie, which are surfaces between the regions of labels. Each vertex lies in a cell of the
// samples' grid; its place is an offset from the cell's first corner, in samples, so that floats suffice.
//
// In the faces of the domain vertices move along the face alone.
//
// Set by the host: DIMENSIONS, 3; RUN, the vertices of a work-item; and what is included.

#include "base/platform.cl"
#include "spline/region.cl"

#define BEYOND 0.1f      // of a cell, as far as a vertex may leave it
#define NEAR 3e-4f       // of the smallest spacing: a vertex that moves by less is on the boundary then, within a square of this
#define FLAT 1e-3f       // of the sum of squared slopes: those that are smaller move nothing
#define STEPS 6
#define HALVINGS 30

// A vertex: its cell, how far along each axis it may go, and whether it may; and the labels at the corners of the cell.
typedef struct {
    int cell[3], moves[3];
    scalar low[3], high[3];
    global const int *around;
} vertex_t;

// size: samples along each axis. edge: from the outer samples to the faces of the domain.
INLINE vertex_t vertex_of(global const int *restrict cells, global const int *restrict around, const size_t n, const int4 size,
                          const scalar edge)
{
    const int last[3] = { size.x - 1, size.y - 1, size.z - 1 };
    vertex_t v;
    v.around = around + 8 * n;
    for (int axis = 0; axis < 3; ++axis) {
        const int cell = v.cell[axis] = cells[3 * n + axis];
        v.moves[axis] = cell >= 0 && cell < last[axis];
        v.low[axis] = v.moves[axis] ? MAX(-BEYOND, -edge - cell) : cell < 0 ? 1.0f - edge : edge;
        v.high[axis] = v.moves[axis] ? MIN(1.0f + BEYOND, last[axis] + edge - cell) : v.low[axis];
    }
    return v;
}

INLINE int corner_bit(const int corner, const int axis) { return corner >> axis & 1; }

// The middle of where the surface crosses the edges of the cell.
INLINE void begin(const vertex_t *v, scalar *offset)
{
    scalar sum[3] = { 0.0f, 0.0f, 0.0f }, crossed = 0.0f;
    for (int corner = 0; corner < 8; ++corner)
        for (int along = 0; along < 3; ++along)
            if (!corner_bit(corner, along) && v->around[corner] != v->around[corner | 1 << along]) {
                crossed += 1.0f;
                for (int axis = 0; axis < 3; ++axis)
                    sum[axis] += axis == along ? 0.5f : (scalar)corner_bit(corner, axis);
            }
    for (int axis = 0; axis < 3; ++axis)
        offset[axis] = v->moves[axis] ? sum[axis] / crossed : v->low[axis];
}

// By how much one label outweighs another, and the derivatives of this along axes in which the vertex moves.
OUT_OF_LINE scalar lead_at(global const LABEL *labels, const int4 extent, const vertex_t *v, const scalar *offset, const int one,
                           const int other, scalar slope[3])
{
    cell_t c = locate(offset[0], offset[1], offset[2], extent.w);
    c.x += v->cell[0];
    c.y += v->cell[1];
    c.z += v->cell[2];
    const region_taps_t taps = taps_around(labels, extent, c);
    scalar both;
    const scalar lead = lead_between(&taps, c, one, other, slope, &both);
    for (int axis = 0; axis < 3; ++axis)
        slope[axis] = v->moves[axis] ? slope[axis] : 0.0f;
    return lead;
}

// The labels at the corners once each, in ascending order; returns how many.
INLINE int labels_of(const vertex_t *v, int found[8])
{
    int count = 0;
    for (int corner = 0; corner < 8; ++corner) {
        const int label = v->around[corner];
        int place = 0;
        while (place < count && found[place] < label)
            ++place;
        if (label == NO_LABEL || (place < count && found[place] == label))
            continue;
        for (int n = count++; n > place; --n)
            found[n] = found[n - 1];
        found[place] = label;
    }
    return count;
}

// Newton's method along gradients in the world. Returns whether the vertex lies on the boundary; else it stays where it was.
INLINE int onto_boundary(global const LABEL *labels, const int4 extent, const vertex_t *v, const scalar *spacing, const int *pair,
                         scalar *offset)
{
    const scalar near = NEAR * MIN(spacing[0], MIN(spacing[1], spacing[2]));
    scalar at[3] = { offset[0], offset[1], offset[2] }, slope[3];
    for (int step = 0; step < STEPS; ++step) {
        const scalar lead = lead_at(labels, extent, v, at, pair[0], pair[1], slope);
        scalar steep = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            slope[axis] /= spacing[axis];
            steep += slope[axis] * slope[axis];
        }
        if (!(steep > 0.0f))
            return 0;
        for (int axis = 0; axis < 3; ++axis) {
            at[axis] -= slope[axis] / spacing[axis] * (lead / steep);
            if (v->moves[axis] && !(at[axis] >= v->low[axis] && at[axis] <= v->high[axis]))
                return 0;
        }
        if (lead * lead <= near * near * steep) {
            for (int axis = 0; axis < 3; ++axis)
                offset[axis] = at[axis];
            return 1;
        }
    }
    return 0;
}

// Halve the way to the nearest corner that lies in the other region; the first label has what is equal.
INLINE void halved(global const LABEL *labels, const int4 extent, const vertex_t *v, const scalar *spacing, const int *pair,
                   scalar *offset)
{
    scalar unused[3], nearest = INFINITY;
    const int own = lead_at(labels, extent, v, offset, pair[0], pair[1], unused) >= 0.0f;
    int end = 0;
    for (int corner = 0; corner < 8; ++corner) {
        scalar distance = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            const scalar along = (corner_bit(corner, axis) - offset[axis]) * spacing[axis];
            distance += along * along;
        }
        if ((v->around[corner] == pair[0]) != own && distance < nearest) {
            nearest = distance;
            end = corner;
        }
    }
    scalar from[3], middle[3], inner = 0.0f, outer = 1.0f;
    for (int axis = 0; axis < 3; ++axis)
        from[axis] = offset[axis];
    for (int n = 0; n <= HALVINGS; ++n) {
        const scalar share = 0.5f * (inner + outer);
        for (int axis = 0; axis < 3; ++axis)
            middle[axis] = from[axis] + share * (corner_bit(end, axis) - from[axis]);
        if ((lead_at(labels, extent, v, middle, pair[0], pair[1], unused) >= 0.0f) == own)
            inner = share;
        else
            outer = share;
    }
    for (int axis = 0; axis < 3; ++axis)
        offset[axis] = middle[axis];
}

// To where all labels weigh the same, by least squares (Gauss and Newton), in the cell. Directions in which nothing changes are left
// alone, since a share of the sum of squares is added to the diagonal.
INLINE void where_more_meet(global const LABEL *labels, const int4 extent, const vertex_t *v, const scalar *spacing, const int *found,
                            const int count, scalar *offset)
{
    for (int step = 0; step < STEPS; ++step) {
        scalar xx = 0.0f, yy = 0.0f, zz = 0.0f, xy = 0.0f, yz = 0.0f, zx = 0.0f, right[3] = { 0.0f, 0.0f, 0.0f };
        for (int other = 1; other < count; ++other) {
            scalar s[3];
            const scalar lead = lead_at(labels, extent, v, offset, found[0], found[other], s);
            for (int axis = 0; axis < 3; ++axis) {
                s[axis] /= spacing[axis];
                right[axis] += s[axis] * lead;
            }
            xx += s[0] * s[0];
            yy += s[1] * s[1];
            zz += s[2] * s[2];
            xy += s[0] * s[1];
            yz += s[1] * s[2];
            zx += s[2] * s[0];
        }
        const scalar more = FLAT * (xx + yy + zz);
        if (!(more > 0.0f))
            return;
        xx += more;
        yy += more;
        zz += more;
        const scalar a = yy * zz - yz * yz, b = yz * zx - xy * zz, c = xy * yz - yy * zx;
        const scalar d = xx * zz - zx * zx, e = xy * zx - xx * yz, f = xx * yy - xy * xy;
        const scalar whole = xx * a + xy * b + zx * c;
        const scalar moves[3] = { a * right[0] + b * right[1] + c * right[2], b * right[0] + d * right[1] + e * right[2],
                                  c * right[0] + e * right[1] + f * right[2] };
        for (int axis = 0; axis < 3; ++axis)
            if (v->moves[axis])
                offset[axis] = MIN(MAX(offset[axis] - moves[axis] / (whole * spacing[axis]), 0.0f), 1.0f);
    }
}

// first, end: vertices of this launch. spacings.w: edge.
kernel void nets_place(global const LABEL *restrict labels, const int4 extent, global const int *restrict cells,
                       global const int *restrict around, const int4 size, const float4 spacings, const ulong first, const ulong end,
                       global float *restrict offsets)
{
    const scalar spacing[3] = { spacings.x, spacings.y, spacings.z };
    const size_t start = first + get_global_id(0) * RUN;
    for (size_t n = start; n < MIN(start + RUN, end); ++n) {
        const vertex_t v = vertex_of(cells, around, n, size, spacings.w);
        int found[8];
        scalar offset[3];
        const int count = labels_of(&v, found);
        begin(&v, offset);
        if (count == 2) {
            if (!onto_boundary(labels, extent, &v, spacing, found, offset) && v.moves[0] && v.moves[1] && v.moves[2])
                halved(labels, extent, &v, spacing, found, offset);
        } else if (count > 2)
            where_more_meet(labels, extent, &v, spacing, found, count, offset);
        for (int axis = 0; axis < 3; ++axis)
            offsets[3 * n + axis] = offset[axis];
    }
}
