// From a value to a colour and an opacity: a function that is linear between its points, and constant beyond them.
//
// If all points are on equally spaced nodes the table holds the nodes, and transfer.pieces is 0. Otherwise it holds the pieces, three
// rows of four numbers each: colour and opacity at the piece's start; their slopes; and its start, 1 - opacity there, the slope of
// that, and the value up to which nothing is visible from this piece on. Piece 0 is before the first point.

#include "base/math.cl"
#include "base/transpose.cl"
#include "frame.cl"

typedef struct {
    real red, green, blue, opacity;
    real clear;   // 1 - opacity: more precise than opacity for nearly opaque matter
} color_t;

#define NEARLY_OPAQUE 0.99f   // no point of a table of equal nodes lies between this and 1
#define PIECE 12              // numbers of a piece
#define START 8               // of them, where it begins; behind it, 1 - opacity and its slope
#define CLEAR_UNTIL 11

INLINE real each_of(global const float *numbers, mask at)
{
    const lane_indices_u index = { at };
    lanes_u result;
    for (int i = 0; i < LANES; ++i)
        result.each[i] = numbers[index.each[i]];
    return result.all;
}

// -- equal nodes -----------------------------------------------------------------------------------------------

INLINE color_t classify_by_nodes(constant transfer_block *transfer, global const float4 *table, real value)
{
    const float last = transfer->last;
    const real place = MIN(MAX((value - transfer->low) * transfer->scale, (real)(0.0f)), (real)(last));
    const mask nodes = to_mask(MIN(place, (real)(last - 1.0f)));
    const real past = place - to_real(nodes);
#if LANES == 1
    const float4 c = madd(past, table[nodes + 1] - table[nodes], table[nodes]);
    const color_t color = { c.x, c.y, c.z, c.w, 1.0f - c.w };
#else
    const lane_indices_u node = { 4 * nodes };
    global const float *channel = (global const float *)table;
    real rows[4], channels[4];
#define LOW(i) *(global const float4 *)(channel + node.each[i])
#define HIGH(i) *(global const float4 *)(channel + node.each[i] + 4)
#define COLORS(i, each) rows[i] = madd(each(past), FOURTHS(HIGH, i) - FOURTHS(LOW, i), FOURTHS(LOW, i));
    COLORS(0, EACH_0)
    COLORS(1, EACH_1)
    COLORS(2, EACH_2)
    COLORS(3, EACH_3)
#undef COLORS
#undef LOW
#undef HIGH
    transpose_fourths(rows, channels);
    const color_t color = { channels[0], channels[1], channels[2], channels[3], 1.0f - channels[3] };
#endif
    return color;
}

// Whether no value from low to high has any opacity. Behind the nodes are n more numbers: for each node, the next one that has
// some, itself included.
INLINE int transparent_by_nodes(constant transfer_block *transfer, global const float4 *table, float low, float high)
{
    const float last = transfer->last;
    global const float *visible = (global const float *)(table + (int)last + 1);
    const float bottom = (low - transfer->low) * transfer->scale, top = (high - transfer->low) * transfer->scale;
    if (!(bottom - bottom == 0.0f && top - top == 0.0f))
        return 0;
    const float from = bottom > 0.0f ? MIN(bottom, last) : 0.0f, to = top > 0.0f ? MIN(top, last) : 0.0f;
    return visible[(int)from] >= to + 1.0f;   // the first visible node colours values past the one before it
}

// -- pieces ----------------------------------------------------------------------------------------------------

// The numbers of the pieces that values lie in: the last that begins no later. Where there are few, values are compared with the
// starts of all, which lie behind them, four at a time; where there are many, a bucket tells the first in question, and halving
// the others. A bucket is the number of that piece, or, where one comparison decides, that, its start and the next one's.
INLINE mask pieces_of(constant transfer_block *transfer, global const float4 *table, real value, real *start)
{
    global const float *starts = (global const float *)table + START;
    mask piece = NONE;
    *start = (real)(starts[0]);
    if (transfer->halvings == 0) {
        global const float *each = (global const float *)table + transfer->pieces * PIECE;
        for (int i = 0; i < transfer->pieces - 1; i += 4) {
#pragma unroll
            for (int k = 0; k < 4; ++k) {
                const mask past = value >= each[i + k];
                piece = past ? (mask)(i + k + 1) : piece;
                *start = choose(past, (real)(each[i + k]), *start);
            }
        }
        return piece;
    }
    const real place = MIN(MAX((value - transfer->low) * transfer->scale, (real)(0.0f)), (real)(transfer->last));
    global const float *buckets = (global const float *)table + transfer->pieces * PIECE;
    if (transfer->halvings == 1) {   // no bucket holds more than one start
#if LANES == 1
        const float4 bucket = *(global const float4 *)(buckets + 4 * to_mask(place));
        const real first = bucket.x, first_start = bucket.y, next_start = bucket.z;
#else
        const lane_indices_u at = { 4 * to_mask(place) };
#define BUCKET(i) *(global const float4 *)(buckets + at.each[i])
        real rows[4] = { FOURTHS(BUCKET, 0), FOURTHS(BUCKET, 1), FOURTHS(BUCKET, 2), FOURTHS(BUCKET, 3) };
#undef BUCKET
        transpose_fourths(rows, rows);
        const real first = rows[0], first_start = rows[1], next_start = rows[2];
#endif
        const mask past = value >= next_start;
        *start = choose(past, next_start, first_start);
        return to_mask(choose(past, first + 1.0f, first));
    }
    piece = to_mask(each_of(buckets, to_mask(place)));
    const mask last = (mask)(transfer->pieces - 1);
    for (int reach = 1 << (transfer->halvings - 1); reach > 0; reach >>= 1) {
        const mask probe = MIN(piece + reach, last);
        piece = value >= each_of(starts, probe * PIECE) ? probe : piece;
    }
    *start = each_of(starts, piece * PIECE);
    return piece;
}

INLINE color_t classify_by_pieces(constant transfer_block *transfer, global const float4 *table, real value)
{
    global const float *numbers = (global const float *)table;
    real start;
    const lane_indices_u piece = { pieces_of(transfer, table, value, &start) * PIECE };
    const real past = value - start;
#if LANES == 1
    const float4 c = madd(past, *(global const float4 *)(numbers + piece.all + 4), *(global const float4 *)(numbers + piece.all));
    color_t color = { c.x, c.y, c.z, c.w, 1.0f - c.w };
#else
    real rows[4], channels[4];
#define BASE(i) *(global const float4 *)(numbers + piece.each[i])
#define SLOPE(i) *(global const float4 *)(numbers + piece.each[i] + 4)
#define COLORS(i, each) rows[i] = madd(each(past), FOURTHS(SLOPE, i), FOURTHS(BASE, i));
    COLORS(0, EACH_0)
    COLORS(1, EACH_1)
    COLORS(2, EACH_2)
    COLORS(3, EACH_3)
#undef COLORS
#undef BASE
#undef SLOPE
    transpose_fourths(rows, channels);
    color_t color = { channels[0], channels[1], channels[2], channels[3], 1.0f - channels[3] };
#endif
    const mask nearly = color.opacity > NEARLY_OPAQUE;
    if (any_lane(nearly))
        color.clear = choose(nearly, madd(past, each_of(numbers + START + 2, piece.all), each_of(numbers + START + 1, piece.all)), color.clear);
    return color;
}

INLINE int transparent_by_pieces(constant transfer_block *transfer, global const float4 *table, float low, float high)
{
    if (!(low <= high))
        return 0;
    global const float *numbers = (global const float *)table;
    int piece = 0, reach = 1;
    while (2 * reach < transfer->pieces)
        reach *= 2;
    for (; reach > 0; reach >>= 1)
        if (piece + reach < transfer->pieces && low >= numbers[(piece + reach) * PIECE + START])
            piece += reach;
    return high <= numbers[piece * PIECE + CLEAR_UNTIL];
}

// -- either ----------------------------------------------------------------------------------------------------

INLINE color_t classify(constant transfer_block *transfer, global const float4 *table, real value)
{
    return transfer->pieces ? classify_by_pieces(transfer, table, value) : classify_by_nodes(transfer, table, value);
}

// Whether no value from low to high has any opacity.
INLINE int transparent(constant transfer_block *transfer, global const float4 *table, float low, float high)
{
    if (low > high)
        return 1;   // no values
    return transfer->pieces ? transparent_by_pieces(transfer, table, low, high) : transparent_by_nodes(transfer, table, low, high);
}

// The base-2 logarithm of the transmittance of matter of this colour that is `thickness` unit distances thick.
INLINE real log_light(color_t color, real thickness)
{
    const mask thin = color.opacity < 0.25f;   // 1 - opacity has lost digits there
    const real light = thickness * log_2_of(MAX(color.clear, (real)(1e-30f)), thin, -color.opacity);
    return choose(color.clear > 0.0f, light, -NOWHERE);
}
