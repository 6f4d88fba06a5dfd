// Kernel: which of several functions is largest, on a grid whose axes are the volume's. The functions come one after the other.
//
// | what makes it fast                                              | where           |
// |-----------------------------------------------------------------|-----------------|
// | a function that is nowhere as large is not evaluated: its       | keep_largest    |
// | values are at most its largest coefficient                      |                 |
// | the rest as in rows.cl                                          |                 |
//
// Set by the host, beside what rows.cl says: NUMBER, the type of a function's number; BY_NEAREST, whether of two functions that
// are as large as each other the one wins that is largest at the nearest sample, else the first.

#include "spline/rows.cl"

typedef PASTE(NUMBER, 8) number8;
typedef number8 number8_at __attribute__((aligned(1)));
#if SCALAR_DOUBLE
typedef long8 truth8;   // as wide as scalar8
#else
typedef int8 truth8;
#endif

INLINE scalar least_of(const scalar8 v)
{
    const scalar4 four = MIN(v.lo, v.hi);
    const scalar2 two = MIN(four.lo, four.hi);
    return MIN(two.x, two.y);
}

INLINE int any_of(const truth8 m)
{
    const number8 narrow = CONVERT(m, number8);
    const PASTE(NUMBER, 4) four = narrow.lo | narrow.hi;
    const PASTE(NUMBER, 2) two = four.lo | four.hi;
    return two.x | two.y;
}

// The largest coefficient that a block of rows of slice `k` is made from. tops: the largest of each row, `rows` to a slice.
INLINE scalar largest_of(global const scalar *restrict tops, const size_t rows, const int k, const int2 used_rows,
                         global const int *restrict used, global const int *restrict z_place)
{
    scalar largest = -INFINITY;
#if DIMENSIONS == 3
    for (int t = 0; t < TAPS; ++t) {
        global const scalar *slice = tops + z_place[k * TAPS + t] * rows;
        for (int j = 0; j < used_rows.y; ++j)
            largest = MAX(largest, slice[used[used_rows.x + j]]);
    }
#else
    for (size_t j = 0; j < rows; ++j)
        largest = MAX(largest, tops[k * rows + j]);
#endif
    return largest;
}

// The arguments of resample_axes up to `room`; then
//
// tops: the largest coefficient of each row, `rows` to a slice. limits: of values, for each slice of the grid. least: the smallest
// value of `largest` in each unit. number: of this function. numbers, nearest: of the functions that are largest, at each point and
// at its nearest sample. largest: the values. Rows of the last three consist of whole vectors.
kernel void keep_largest(global const scalar *restrict coefficients, const int left, const ulong pitch,
                         const ulong area, const int width, global const int *restrict places, global const scalar *restrict weights,
                         global const int2 *restrict blocks, global const int *restrict used, const int4 grid,
                         const int first, const int units, global scalar *restrict scratch, const ulong room,
                         global const scalar *restrict tops, const ulong rows, global const scalar2 *restrict limits,
                         global scalar *restrict least, const uint number, global const NUMBER *restrict nearest,
                         global NUMBER *restrict numbers, global scalar *restrict largest)
{
    const size_t item = get_global_id(0), items = get_global_size(0);
    const size_t along_y = grid.w, along_z = along_y + (size_t)grid.y * TAPS, points = (grid.x + LANES - 1) / LANES * LANES;
    const size_t apart = DIMENSIONS == 3 ? width : pitch;
    global scalar *mine = scratch + item * room, *lines = mine, *columns = mine + LANES * width;
    coefficients += left;
    const int end = first + units * (item + 1) / items;
    for (int unit = first + units * item / items; unit < end; ++unit) {
        const int block = unit / grid.z, k = unit % grid.z;
        const scalar8 low = (scalar8)(limits[k].x), high = (scalar8)(limits[k].y);
        const scalar most = largest_of(tops, rows, k, blocks[block], used, places + along_z);
        if (MAX(most, low.x) + ROUNDING * (most < 0.0f ? -most : most) < least[unit])
            continue;
        global const scalar *from = sum_slices(mine + 2 * LANES * width, coefficients, pitch, area, k, blocks[block], used,
                                               places + along_z, weights + along_z, width);
        scalar8 smallest = (scalar8)(INFINITY);
        for (int j = block * BLOCK; j < MIN((block + 1) * BLOCK, grid.y); j += LANES) {
            const int count = MIN(LANES, grid.y - j);
            scalar8 v[LANES];
            sum_to_columns(columns, from, apart, places + along_y + j * TAPS, weights + along_y + j * TAPS, count, width, lines);
            for (int i = 0; i < points; i += LANES) {
                sum_columns(v, columns, i, places, weights);
                store_columns(v, lines, LANES, LANES);
                for (int r = 0; r < count; ++r) {
                    const size_t at = ((size_t)k * grid.y + j + r) * points + i;
                    const scalar8 value = MIN(MAX(*(global const scalar8_at *)(lines + r * LANES), low), high);
                    const scalar8 before = *(global const scalar8_at *)(largest + at);
                    truth8 wins = value > before;
#if BY_NEAREST
                    const truth8 here = CONVERT(*(global const number8_at *)(nearest + at), truth8) == (truth8)(number);
                    wins |= (value == before) & here;
#endif
                    const scalar8 now = MAX(value, before);
                    smallest = MIN(smallest, now);
                    if (any_of(wins)) {
                        const number8 won = CONVERT(wins, number8);
                        global number8_at *const kept = (global number8_at *)(numbers + at);
                        *(global scalar8_at *)(largest + at) = now;
                        *kept = (won & (number8)(number)) | (~won & *kept);
                    }
                }
            }
        }
        least[unit] = least_of(smallest);
    }
}
