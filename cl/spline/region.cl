// The region that a position lies in: that of the label with the largest weight among the samples around it.
//
// Each label has an indicator, 1 at its samples and 0 at others. The filter makes of it a function, the sum of the weights of the
// label's taps: nowhere negative, and one in sum over all labels. Labels are taken one after the other, first a sample's near
// by, then the others in ascending order, until what is left cannot exceed the largest. So there may be any number of them, and no list
// of them is kept. Nearly equal weights are equal: then the smaller label wins, on whichever side of a boundary rounding falls.
//
// Set by the host: LABEL, the type of stored labels, of at most 32 bits, or float; LABEL_BYTES, its size. No label is INT_MAX.

#include "spline/filter.cl"
#include "spline/cell.cl"

typedef PASTE(LABEL, ROW) label_row_at __attribute__((aligned(LABEL_BYTES)));
typedef PASTE(int, ROW) label_row_t;
#define AS_MASK PASTE(as_int, ROW)
#define AS_ROW PASTE(as_float, ROW)

#define NO_LABEL INT_MAX
#define SAME_WEIGHT 1e-6f   // several times what the sum of all weights may be off by

#if DIMENSIONS == 3
#define TAP_SLICES TAPS
#else
#define TAP_SLICES 1
#endif

// The taps around a position: the first one's place, the distances between rows and slices, and the weights along x, y and z.
typedef struct {
    global const LABEL *first;
    size_t pitch, area;
    row_t x[CHUNKS];
    scalar y[TAPS], z[TAP_SLICES];
} region_taps_t;

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
    union { label_row_t row; int each[ROW]; } found;
    found.row = smallest;
    *next = found.each[0];
#pragma unroll
    for (int i = 1; i < ROW; ++i)
        *next = MIN(found.each[i], *next);
    return row_sum(sum);
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

// nearest: the label of a sample near by, which is tried first.
INLINE int region_of(const region_taps_t *taps, const int nearest)
{
    if (weight_of(taps, nearest) > 0.5f + 2 * SAME_WEIGHT)
        return nearest;
    int winner = nearest, next;
    scalar most = label_weight(taps, nearest, INT_MIN, nearest, &next), rest = 1.0f - most;
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

// The taps in the middle: where they are equal, and hold over half of the weight, they decide alone.
#define CORE (TAPS % 2 ? 3 : 2)
#define CORE_FIRST ((TAPS - CORE) / 2)

INLINE scalar core_weight(const scalar *w)
{
    scalar sum = 0.0f;
    for (int n = 0; n < CORE; ++n)
        sum += w[CORE_FIRST + n];
    return sum;
}

// By how much the weight of one label exceeds that of another, and the gradient of this per sample. Weights along x come last.
INLINE scalar lead_between(const region_taps_t *taps, const cell_t c, const int one, const int other, scalar gradient[3])
{
    scalar slopes_y[WEIGHTS], slopes_z[WEIGHTS];
    row_t lead = (row_t)(0.0f), along = lead, across = lead, deep = lead;
    unpack_slopes(c.ty, slopes_y);
    unpack_slopes(c.tz, slopes_z);
    for (int i = 0; i < CHUNKS; ++i) {
        row_t sum = (row_t)(0.0f), sum_across = sum, sum_deep = sum;
        for (int k = 0; k < TAP_SLICES; ++k) {
            row_t slice = (row_t)(0.0f), slice_across = slice;
            for (int j = 0; j < TAPS; ++j) {
                global const LABEL *row = taps->first + k * taps->area + j * taps->pitch;
                const label_row_t labels = CONVERT(*(global const label_row_at *)(row + i * ROW), label_row_t);
                const row_t side = CONVERT((labels == other) - (labels == one), row_t);
                slice = madd((row_t)(taps->y[j]), side, slice);
                slice_across = madd((row_t)(slopes_y[j]), side, slice_across);
            }
            sum = madd((row_t)(taps->z[k]), slice, sum);
            sum_across = madd((row_t)(taps->z[k]), slice_across, sum_across);
            sum_deep = madd((row_t)(slopes_z[k]), slice, sum_deep);
        }
        lead = madd(taps->x[i], sum, lead);
        along = madd(tap_slopes(c.tx, i), sum, along);
        across = madd(taps->x[i], sum_across, across);
        deep = madd(taps->x[i], sum_deep, deep);
    }
    gradient[0] = row_sum(along);
    gradient[1] = row_sum(across);
    gradient[2] = row_sum(deep);
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

// The region of the position of a cell.
INLINE int region_in(global const LABEL *restrict labels, const int4 extent, const cell_t c)
{
    const region_taps_t taps = taps_around(labels, extent, c);
    global const LABEL *inner = taps.first + CORE_FIRST * (1 + taps.pitch);
    scalar core = core_weight((const scalar *)taps.x) * core_weight(taps.y);
#if DIMENSIONS == 3
    core *= core_weight(taps.z);
    inner += CORE_FIRST * taps.area;
#endif
    if (core > 0.5f + 2 * SAME_WEIGHT) {
        int same = 1;
        for (int k = 0; k < MIN(CORE, TAP_SLICES); ++k)
            for (int j = 0; j < CORE; ++j)
                for (int i = 0; i < CORE; ++i)
                    same &= inner[k * taps.area + j * taps.pitch + i] == *inner;
        if (same)
            return (int)*inner;
    }
    return region_of(&taps, (int)*inner);
}
