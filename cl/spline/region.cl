// The region that a position lies in: that of the label with the largest weight among the samples around it.
//
// Each label has an indicator, 1 at its samples and 0 at others. The filter makes of it a function, the sum of the weights of the
// label's taps: nowhere negative, and one in sum over all labels. Labels are taken one after the other, first a sample's near
// by, then the others in ascending order, until what is left cannot exceed the largest. So there may be any number of them, and no list
// of them is kept. Nearly equal weights are equal: then the smaller label wins, on whichever side of a boundary rounding falls.
//
// Set by the host: SPARED, the outer taps on each side without which the others still hold over half of the weight, wherever the
// position: where these, the core, are equal, they decide. LABEL, the type of stored labels, of at most 32 bits, or float; LABEL_BYTES,
// its size. No label is INT_MAX.

#include "spline/filter.cl"
#include "spline/cell.cl"

typedef PASTE(LABEL, ROW) label_row_at __attribute__((aligned(LABEL_BYTES)));
typedef PASTE(int, ROW) label_row_t;
#define AS_MASK PASTE(as_int, ROW)
#define AS_ROW PASTE(as_float, ROW)

#define NO_LABEL INT_MAX
#define SAME_WEIGHT 1e-6f   // several times what the sum of all weights may be off by
#define MAJORITY (0.5f + 2 * SAME_WEIGHT)
#define CORE (TAPS - 2 * SPARED)   // taps along an axis

#if DIMENSIONS == 3
#define TAP_SLICES TAPS
#define SPARED_SLICES SPARED
#else
#define TAP_SLICES 1
#define SPARED_SLICES 0
#endif

// The taps around a position: the first one's place, the distances between rows and slices, and the weights along x, y and z.
typedef struct {
    global const LABEL *first;
    size_t pitch, area;
    row_t x[CHUNKS];
    scalar y[TAPS], z[TAP_SLICES];
} region_taps_t;

typedef union { label_row_t row; int each[ROW]; } label_row_u;

INLINE int least_of_row(const label_row_t row)
{
    const label_row_u all = { row };
    int least = all.each[0];
#pragma unroll
    for (int i = 1; i < ROW; ++i)
        least = MIN(all.each[i], least);
    return least;
}

// A label's weight. next: the smallest label from `least` on, other than `but`, that has weight; or NO_LABEL.
INLINE scalar label_weight(const region_taps_t *taps, const int label, const int least, const int but, int *next)
{
    row_t sum = (row_t)(0.0f);
    label_row_t smallest = (label_row_t)(NO_LABEL);
#pragma unroll 1
    for (int k = 0; k < TAP_SLICES; ++k) {
        global const LABEL *row = taps->first + k * taps->area;
#pragma unroll
        for (int j = 0; j < TAPS; ++j, row += taps->pitch) {
            const scalar weight = taps->y[j] * taps->z[k];
            if (!(weight > 0.0f))
                continue;
#pragma unroll
            for (int i = 0; i < CHUNKS; ++i) {
                const label_row_t labels = CONVERT(*(global const label_row_at *)(row + i * ROW), label_row_t);
                sum = madd((row_t)(weight), AS_ROW((labels == label) & AS_MASK(taps->x[i])), sum);
                const label_row_t others = (labels >= least) & (labels != but) & (taps->x[i] > 0.0f);
                const label_row_t offered = (others & labels) | (~others & NO_LABEL);
                smallest = MIN(offered, smallest);
            }
        }
    }
    *next = least_of_row(smallest);
    return row_sum(sum);
}

// The smallest label of a tap that has weight, other than `but`; or NO_LABEL.
INLINE int next_label(const region_taps_t *taps, const int but)
{
    label_row_t smallest = (label_row_t)(NO_LABEL);
    for (int k = 0; k < TAP_SLICES; ++k) {
        global const LABEL *row = taps->first + k * taps->area;
#pragma unroll
        for (int j = 0; j < TAPS; ++j, row += taps->pitch)
#pragma unroll
            for (int i = 0; i < CHUNKS; ++i) {
                const label_row_t labels = CONVERT(*(global const label_row_at *)(row + i * ROW), label_row_t);
                const label_row_t others = (labels != but) & (taps->x[i] > 0.0f);
                smallest = MIN((others & labels) | (~others & NO_LABEL), smallest);
            }
    }
    return least_of_row(smallest);
}

// The weight of a label alone.
INLINE scalar weight_of(const region_taps_t *taps, const int label)
{
    row_t sum = (row_t)(0.0f);
    for (int k = 0; k < TAP_SLICES; ++k) {
        row_t slice = (row_t)(0.0f);
        global const LABEL *row = taps->first + k * taps->area;
#pragma unroll
        for (int j = 0; j < TAPS; ++j, row += taps->pitch)
#pragma unroll
            for (int i = 0; i < CHUNKS; ++i) {
                const label_row_t here = CONVERT(*(global const label_row_at *)(row + i * ROW), label_row_t) == label;
                slice = madd((row_t)(taps->y[j]), AS_ROW(here & AS_MASK(taps->x[i])), slice);
            }
        sum = madd((row_t)(taps->z[k]), slice, sum);
    }
    return row_sum(sum);
}

#if CORE == 4

typedef PASTE(LABEL, 4) core_row_at __attribute__((aligned(LABEL_BYTES)));

// The part of it that is in the core.
INLINE scalar core_weight_of(const region_taps_t *taps, const int label)
{
    const scalar4 along = *(const scalar4_at *)((const scalar *)taps->x + SPARED);
    scalar4 sum = (scalar4)(0.0f);
    for (int k = SPARED_SLICES; k < TAP_SLICES - SPARED_SLICES; ++k) {
        scalar4 slice = (scalar4)(0.0f);
        global const LABEL *row = taps->first + k * taps->area + SPARED * taps->pitch + SPARED;
#pragma unroll
        for (int j = SPARED; j < TAPS - SPARED; ++j, row += taps->pitch) {
            const int4 here = CONVERT(*(global const core_row_at *)row, int4) == label;
            slice = madd((scalar4)(taps->y[j]), as_float4(here & as_int4(along)), slice);
        }
        sum = madd((scalar4)(taps->z[k]), slice, sum);
    }
    return sum.x + sum.y + sum.z + sum.w;
}

#endif

// nearest: the label of a sample near by, which is tried first.
INLINE int region_of(const region_taps_t *taps, const int nearest)
{
#if CORE == 4
    if (core_weight_of(taps, nearest) > MAJORITY)
        return nearest;
#endif
    scalar most = weight_of(taps, nearest), rest = 1.0f - most;
    if (most > MAJORITY)
        return nearest;
    int winner = nearest, next = next_label(taps, nearest);
    while (next != NO_LABEL && most <= rest + 2 * SAME_WEIGHT) {
        const int label = next;
        const scalar weight = label_weight(taps, label, label + 1, nearest, &next);
        rest -= weight;
        if (weight > most + SAME_WEIGHT || (weight >= most - SAME_WEIGHT && label < winner)) {
            winner = label;
            most = weight;
        }
    }
    return winner;
}

// The taps around the position of a cell.
INLINE region_taps_t taps_around(global const LABEL *restrict labels, const int4 extent, const cell_t c)
{
    region_taps_t taps;
    scalar w[WEIGHTS];
    taps.pitch = extent.x;
    taps.area = (size_t)extent.x * extent.y;
    taps.first = labels + c.z * taps.area + c.y * taps.pitch + c.x;
    unpack_weights(c.ty, w);
    for (int n = 0; n < TAPS; ++n)
        taps.y[n] = w[n];
#if DIMENSIONS == 3
    unpack_weights(c.tz, w);
    for (int n = 0; n < TAPS; ++n)
        taps.z[n] = w[n];
#else
    taps.z[0] = 1.0f;
#endif
#pragma unroll
    for (int n = 0; n < CHUNKS; ++n)
        taps.x[n] = tap_weights(c.tx, n);
    return taps;
}

// By how much the weight of one label exceeds that of another, and the gradient of this per sample; and the sum of both.
INLINE scalar lead_between(const region_taps_t *taps, const cell_t c, const int one, const int other, scalar gradient[3], scalar *both)
{
    scalar slopes_y[WEIGHTS], slopes_z[WEIGHTS];
    unpack_slopes(c.ty, slopes_y);
    unpack_slopes(c.tz, slopes_z);
    row_t lead = (row_t)(0.0f), along = lead, across = lead, deep = lead, sum = lead;
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        row_t sides = (row_t)(0.0f), across_y = sides, across_z = sides, shares = sides;
        for (int k = 0; k < TAP_SLICES; ++k) {
            global const LABEL *row = taps->first + k * taps->area + i * ROW;
            row_t slice = (row_t)(0.0f), slope = slice, share = slice;
#pragma unroll
            for (int j = 0; j < TAPS; ++j, row += taps->pitch) {
                const label_row_t labels = CONVERT(*(global const label_row_at *)row, label_row_t);
                const row_t side = CONVERT((labels == other) - (labels == one), row_t);
                slice = madd((row_t)(taps->y[j]), side, slice);
                slope = madd((row_t)(slopes_y[j]), side, slope);
                share = madd((row_t)(taps->y[j]), side * side, share);
            }
            sides = madd((row_t)(taps->z[k]), slice, sides);
            across_y = madd((row_t)(taps->z[k]), slope, across_y);
            across_z = madd((row_t)(slopes_z[k]), slice, across_z);
            shares = madd((row_t)(taps->z[k]), share, shares);
        }
        lead = madd(taps->x[i], sides, lead);
        along = madd(tap_slopes(c.tx, i), sides, along);
        across = madd(taps->x[i], across_y, across);
        deep = madd(taps->x[i], across_z, deep);
        sum = madd(taps->x[i], shares, sum);
    }
    gradient[0] = row_sum(along);
    gradient[1] = row_sum(across);
    gradient[2] = row_sum(deep);
    *both = row_sum(sum);
    return row_sum(lead);
}

// The label with the largest weight but one, or that one if there is no other.
INLINE int region_beside(const region_taps_t *taps, const int winner)
{
    int beside = winner, next;
    scalar most = 0.0f;
    label_weight(taps, winner, INT_MIN, winner, &next);
    while (next != NO_LABEL) {
        const int label = next;
        const scalar weight = label_weight(taps, label, label + 1, winner, &next);
        if (weight > most) {
            beside = label;
            most = weight;
        }
    }
    return beside;
}

// Whether all labels of the core that begins at a place are equal.
INLINE int core_is_one(global const LABEL *core, const size_t pitch, const size_t area)
{
#if CORE == 4
    int4 differ = (int4)(0);
#pragma unroll
    for (int k = 0; k < MIN(CORE, TAP_SLICES); ++k)
#pragma unroll
        for (int j = 0; j < CORE; ++j)
            differ |= CONVERT(*(global const core_row_at *)(core + k * area + j * pitch), int4) != (int)*core;
    return !(differ.x | differ.y | differ.z | differ.w);
#else
    int same = 1;
    for (int k = 0; k < MIN(CORE, TAP_SLICES); ++k)
        for (int j = 0; j < CORE; ++j)
            for (int i = 0; i < CORE; ++i)
                same &= core[k * area + j * pitch + i] == *core;
    return same;
#endif
}

// Of an even number of taps the first one behind the middle is not the nearest there.
#define MIDDLE(t) (TAPS % 2 == 0 && (t) < 0.5f)

// The region of the position of a cell.
INLINE int region_in(global const LABEL *restrict labels, const int4 extent, const cell_t c)
{
    const size_t pitch = extent.x, area = pitch * extent.y;
    global const LABEL *core = labels + (c.z + SPARED_SLICES) * area + (c.y + SPARED) * pitch + c.x + SPARED;
    if (core_is_one(core, pitch, area))
        return (int)*core;
    const region_taps_t taps = taps_around(labels, extent, c);
    const int middle = TAPS / 2 - SPARED;
    core += (middle - MIDDLE(c.ty)) * pitch + middle - MIDDLE(c.tx);
    return region_of(&taps, (int)core[TAP_SLICES > 1 ? (middle - MIDDLE(c.tz)) * area : 0]);
}
