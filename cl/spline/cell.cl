// From a position in samples to the cell that holds it among the stored coefficients.

// Set by the host: LEFT = TAPS/2 - 1, exactly, as a floating constant.

// The greatest whole number below, for what fits an int.
INLINE coord whole_below(coord x)
{
    const coord i = (coord)(int)x;
    return x < i ? i - 1 : i;
}

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

// The same within the domain, where no stored coefficient that is asked for has a negative index: cutting off is enough.
INLINE int locate_inner_axis(coord x, int halo, float *t)
{
    const coord u = x * GRID_SCALE + ((coord)halo - (coord)LEFT);
    const int base = (int)u;
    *t = (float)(u - base);
    return base;
}

INLINE cell_t locate_inner(coord x, coord y, coord z, int halo)
{
    cell_t c;
    c.x = locate_inner_axis(x, halo, &c.tx);
    c.y = locate_inner_axis(y, halo, &c.ty);
#if DIMENSIONS == 3
    c.z = locate_inner_axis(z, halo, &c.tz);
#else
    c.z = 0;
    c.tz = 0.0f;
#endif
    return c;
}
