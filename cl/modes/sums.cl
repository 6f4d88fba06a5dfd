// What modes of line integrals have in common. Set before: state_t, with the `sum`.
//
// Values count from `zero`, with `clamped` only those above it. Those nearer than `least`, which is rounding, add nothing, to the last
// bit: blocks of such values are skipped.

#define REACH 0.0f
#define ANY_ORDER 0
#define WHOLE_TILES 1
#define PROMISE(low, high) 0.0f

INLINE mask finished(const state_t *s, constant frame_t *frame) { return NONE; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    constant mode_block *mode = &frame->mode;
    return (high - mode->zero >= mode->least) | (!mode->clamped & (mode->zero - low >= mode->least));
}

INLINE real height_of(constant frame_t *frame, const real value)
{
    const real height = value - frame->mode.zero;
    return choose((frame->mode.clamped ? height : magnitude(height)) >= frame->mode.least, height, (real)(0.0f));
}

// The length of the stretch of a sample, in mean spacings.
INLINE real length_of(const sample_t *sample, const real t, const mask active)
{
    const ray_t *ray = sample->ray;
    real before, behind;
    int uneven = stretch_of(ray, sample->number, t, active, &before, &behind);
#if MISSING
    stretch_to_edges(sample->missing, sample->frame, ray, t, active, &before, &behind);
    uneven = 1;
#endif
    return uneven ? before + behind : ray->step;
}

INLINE real place_of(const state_t *s) { return NOWHERE; }

#define VALUE_OF(s, sample) ((sample)->frame->mode.scale * (s)->sum)

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    constant frame_t *frame = sample->frame;
    const ray_t *ray = sample->ray;
    color_t color = classify(&frame->transfer, sample->table, VALUE_OF(s, sample));
    real enter = ray->enter, leave = ray->leave;
    if (frame->clip.corners) {
        const real least = frame->planes.margin / square_root(dot3(ray->direction, ray->direction));
        keep_part(&frame->clip, matrix3(frame->geometry.index_to_world, ray->origin), ray->world, 0, least, &enter, &leave);
    }
    color.opacity = choose(ray->hits & (enter <= leave), (real)(1.0f), (real)(0.0f));
    return color;
}
