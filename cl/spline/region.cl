// The region that a position lies in: that of the label with the largest weight among the samples around it.
//
// Each label has an indicator, 1 at its samples and 0 at others. The filter makes of it a function, the sum of the weights of the
// label's taps: nowhere negative, and one in sum over all labels. Labels are taken one after the other, first a sample's near
// by, then the others in ascending order, until what is left cannot exceed the largest. So there may be any number of them, and no list
// of them is kept. Nearly equal weights are equal: then the smaller label wins, on whichever side of a boundary rounding falls.
//
// Set by the host: LABEL, the type of stored labels, of at most 32 bits; LABEL_BYTES, its size. No label is INT_MAX.

#include "spline/filter.cl"

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

// nearest: the label of a sample near by, which is tried first.
INLINE int region_of(const region_taps_t *taps, const int nearest)
{
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
