// Kernels: the regions of labels on a grid, or at points.
//
// | what makes it fast on a grid whose axes are the volume's             | where          |
// |----------------------------------------------------------------------|----------------|
// | samples that hold over half of the weight decide where they are equal | regions_along_axes |
// | rows of samples are compared once for all points of a row             | regions_along_axes |
// | weights come from tables                                              | the host       |
// | a label's weight is that of rows, compared as vectors                 | region.cl      |
//
// Set by the host: ALONG_AXES, whether the grid's axes are the volume's; DIMENSIONS; and what is included.

#include "base/platform.cl"
#include "spline/region.cl"

#if ALONG_AXES

typedef row_t row_at_label_t __attribute__((aligned(4)));

// The samples of a row that differ among `count` rows and slices have bits set.
INLINE void differences_into(global LABEL *restrict differences, global const LABEL *restrict rows, const size_t pitch,
                             const size_t area, const int2 count, const int width)
{
    for (int i = 0; i < width; ++i)
        differences[i] = 0;
    for (int k = 0; k < count.y; ++k)
        for (int j = k == 0; j < count.x; ++j) {
            global const LABEL *restrict row = rows + k * area + j * pitch;
            for (int i = 0; i < width; ++i)
                differences[i] |= row[i] ^ rows[i];
        }
}

// A work-item makes some of `units` rows in turn.
//
// places: for each column, then row and slice, where the first tap lies. cores: likewise where the first of those lies that hold most
// of the weight, and how many do. weights: WEIGHTS for each. grid: points along x, y and z; and the columns of samples that are
// used. scratch: grid.w samples for each work-item.
kernel void regions_along_axes(global const LABEL *restrict labels, const ulong pitch, const ulong area,
                               global const int *restrict places, global const int2 *restrict cores,
                               global const float *restrict weights, const int4 grid, const int first, const int units,
                               global LABEL *restrict scratch, global LABEL *restrict results)
{
    const long item = get_global_id(0), items = get_global_size(0);
    global LABEL *differences = scratch + item * grid.w;
    region_taps_t taps;
    taps.pitch = pitch;
    taps.area = area;
    const int end = first + (int)(units * (item + 1) / items);
    for (int unit = first + (int)(units * item / items); unit < end; ++unit) {
        const int row = grid.x + unit % grid.y;
        for (int n = 0; n < TAPS; ++n)
            taps.y[n] = weights[(size_t)row * WEIGHTS + n];
        const int2 y = cores[row];
#if DIMENSIONS == 3
        const int slice = grid.x + grid.y + unit / grid.y;
        const int2 z = cores[slice];
        const size_t start = (size_t)places[slice] * area + (size_t)places[row] * pitch;
        for (int n = 0; n < TAPS; ++n)
            taps.z[n] = weights[(size_t)slice * WEIGHTS + n];
#else
        const int2 z = (int2)(0, 1);
        const size_t start = (size_t)places[row] * pitch;
        taps.z[0] = 1.0f;
#endif
        global const LABEL *core = labels + z.x * area + y.x * pitch;
        global const LABEL *middle = core + z.y / 2 * area + y.y / 2 * pitch;
        global LABEL *result = results + (size_t)unit * grid.x;
        differences_into(differences, core, pitch, area, (int2)(y.y, z.y), grid.w);
        for (int i = 0; i < grid.x; ++i) {
            const int2 x = cores[i];
            const LABEL label = core[x.x];
            LABEL differ = differences[x.x];
            for (int n = 1; n < x.y; ++n)
                differ |= differences[x.x + n] | (core[x.x + n] ^ label);
            if (!differ) {
                result[i] = label;
                continue;
            }
            taps.first = labels + start + places[i];
#pragma unroll
            for (int n = 0; n < CHUNKS; ++n)
                taps.x[n] = *(global const row_at_label_t *)(weights + (size_t)i * WEIGHTS + n * ROW);
            result[i] = (LABEL)region_of(&taps, middle[x.x + x.y / 2]);
        }
    }
}

#else

#include "spline/outside.cl"

// given: the label outside, and the boundary rule's.
INLINE LABEL region_at(global const LABEL *restrict labels, const int4 extent, position_t at, const int4 size, const int4 period,
                       const int2 given)
{
    along_t unused;
    if (!within_volume(at, size)) {
        const int kind = bring(&at, size, period, &unused);
        if (kind != SAMPLED)
            return (LABEL)(kind == VALUED ? given.y : given.x);
    }
    return (LABEL)region_in(labels, extent, locate_inner(at.x, at.y, at.z, extent.w));
}

// A work-item takes RUN points.

#if ON_GRID

// grid: points along x and y, and the first row and slice of this launch.
kernel void regions_on_grid(global const LABEL *restrict labels, const int4 extent, const int4 size, const int4 period,
                            constant coord *transform, const int4 grid, const int2 given, global LABEL *results CHAIN_ARGUMENTS)
{
    const source_t source = { get_global_id(0) * RUN, (int)get_global_id(1) + grid.z, (int)get_global_id(2) + grid.w, 0 CHAIN_GIVEN };
    global LABEL *result = results + ((size_t)source.k * grid.y + source.j) * grid.x + source.i;
    for (int n = 0; n < MIN(RUN, grid.x - source.i); ++n)
        result[n] = region_at(labels, extent, index_of(point_of(source, n), transform), size, period, given);
}

#else

// points: indices, in planes, the axis z first.
kernel void regions_at_points(global const LABEL *restrict labels, const int4 extent, const int4 size, const int4 period,
                              global const POINT *points, const ulong planes, const int2 given, global LABEL *results)
{
    const source_t source = { points, get_global_id(0) * RUN, planes };
    for (int n = 0; n < RUN && source.first + n < planes; ++n)
        results[source.first + n] = region_at(labels, extent, given_point(source, n), size, period, given);
}

#endif
#endif
