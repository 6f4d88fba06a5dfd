// Missing samples: where a ray is at a place without a value, nothing is shown there.
//
// `missing` has a byte for each cube between eight neighbouring samples, [z, y, x], from that before the first sample to that after
// the last along each axis; beyond the faces are the samples on them. Bit 4 z + 2 y + x is set where that corner is missing. A place
// is missing where more than half of the corners are, weighted by linear interpolation; or, if a filter has one tap, where its
// sample is.
//
// Set by the host: MISSING, whether any sample is.

#if MISSING

#define AND_MISSING , missing                            // the last argument, and the last member of a sample_t
#define MISSING_TOO , global const uchar *missing        // the parameter

// The cube that contains a position along an axis, and the fraction past its first corner.
INLINE int cube_at(constant gaps_block *gaps, const int axis, const float x, float *fraction)
{
    const int number = (int)(x + 1.0f), last = gaps->cubes[axis] - 1, cube = number - gaps->first[axis];
    const float past = x - (float)(number - 1);
    *fraction = TAPS > 1 ? past : past < 0.5f ? 0.0f : 1.0f;
    return cube < 0 ? 0 : cube > last ? last : cube;
}

INLINE int missing_one(global const uchar *missing, constant gaps_block *gaps, const float x, const float y, const float z)
{
    float u, v, w;
    const int i = cube_at(gaps, 0, x, &u), j = cube_at(gaps, 1, y, &v), k = cube_at(gaps, 2, z, &w);
    const int corners = missing[((size_t)k * gaps->cubes[1] + j) * gaps->cubes[0] + i];
    if (corners == 0 || corners == 255)
        return corners;
    const float along[2] = { 1.0f - u, u }, across[2] = { 1.0f - v, v }, deep[2] = { 1.0f - w, w };
    float share = 0.0f;
    for (int corner = 0; corner < 8; ++corner)
        if (corners >> corner & 1)
            share += along[corner & 1] * across[corner >> 1 & 1] * deep[corner >> 2];
    return share > 0.5f;
}

// The lanes whose places at t are missing.
INLINE mask missing_at(global const uchar *missing, constant frame_t *frame, const ray_t *ray, const real t, const mask active)
{
    const real3 p = at3(ray->origin, ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lane_masks_u gone = { NONE };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            gone.each[i] = missing_one(missing, &frame->gaps, x.each[i], y.each[i], z.each[i]);
    return active & (gone.all != 0);
}

// How far rays have values on one side of samples at t, up to `other`, a place that is missing: halved until float32 hardly tells.
OUT_OF_LINE real length_to_edge(global const uchar *missing, constant frame_t *frame, const ray_t *ray, const real t, real other,
                                const mask active)
{
    real near = t;
    for (int i = 0; i < 10; ++i) {
        const real middle = 0.5f * (near + other);
        const mask gone = missing_at(missing, frame, ray, middle, active);
        other = choose(gone, middle, other);
        near = choose(gone, near, middle);
    }
    return magnitude(0.5f * (near + other) - t);
}

// The stretches of samples at t (stretch_of): where the next sample, or the ray's end, is missing they end at the edge in between.
INLINE void stretch_to_edges(global const uchar *missing, constant frame_t *frame, const ray_t *ray, const real t, const mask active,
                             real *before, real *behind)
{
    const real last = MAX(t - ray->step, ray->enter), next = MIN(t + ray->step, ray->leave);
    const mask after_gap = missing_at(missing, frame, ray, last, active), before_gap = missing_at(missing, frame, ray, next, active);
    if (any_lane(after_gap))
        *before = choose(after_gap, length_to_edge(missing, frame, ray, t, last, after_gap), *before);
    if (any_lane(before_gap))
        *behind = choose(before_gap, length_to_edge(missing, frame, ray, t, next, before_gap), *behind);
}

#else

#define AND_MISSING
#define MISSING_TOO

#endif
