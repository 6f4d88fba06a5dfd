// From a position in samples to the cell that holds it among the stored coefficients.

// Set by the host: LEFT = TAPS/2 - 1, exactly, as a floating constant.

INLINE int locate_axis(coord x, float *t)
{
    const coord u = x * GRID_SCALE - (coord)LEFT, base = whole_below(u);
    *t = (float)(u - base);
    return (int)base;
}

INLINE cell_t locate(coord x, coord y, coord z, int halo)
{
    cell_t c;
    c.x = locate_axis(x, &c.tx) + halo;
    c.y = locate_axis(y, &c.ty) + halo;
#if DIMENSIONS == 3
    c.z = locate_axis(z, &c.tz) + halo;
#else
    c.z = 0;
    c.tz = 0.0f;
#endif
    return c;
}
