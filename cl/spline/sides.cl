// The format of what is known of the function in each cell beside some values: two bits, SIDES_EDGE cubed cells for each brick.
//
// Cells are numbered by their first tap among the stored coefficients, as in minmax.cl.
//
// Set by the host: BLOCK, cells along an edge of the finest blocks of the pyramid, a multiple of SIDES_EDGE.

#define SIDES_EDGE 4
#define BRICKS (BLOCK / SIDES_EDGE)   // along an edge of a block
#define ALL_CELLS (~(ulong)0)

// The bit of a cell in its brick.
#define BIT_OF(x, y, z) ((((z) % SIDES_EDGE) * SIDES_EDGE + (y) % SIDES_EDGE) * SIDES_EDGE + (x) % SIDES_EDGE)
