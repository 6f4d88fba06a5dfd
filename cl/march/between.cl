// Virtual samples: matter between two samples of a ray, for modes whose state_t has the last two (composite.cl).

// How much longer gradients in their own unit are than the function's slope along a ray, by its t.
INLINE float per_slope(constant geometry_block *geometry)
{
    constant float *g = geometry->gradient, *m = geometry->index_to_world;
    return g[0] * m[0] + g[1] * m[3] + g[2] * m[6];   // one is the inverse of the other, but for their units
}

// Virtual samples between the sample before and the one at t. Where neither is visible, values stay between theirs: then nothing is
// seen that the minimum and the maximum of samples does not tell (segments.cl).
INLINE void absorb_between(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, const real t, const real value,
                           const mask shown, const real3 gradient, const mask both)
{
    constant frame_t *frame = sample->frame;
    const int count = frame->mode.between;
    const real3 world = sample->ray->world, before = real3_of(s->x, s->y, s->z);
    const real from = choose(both, s->t, t), length = t - from, first = choose(both, s->value, value);
    const real unit = (real)(per_slope(&frame->geometry)), to_slope = length / unit;
    const real rise = value - first, slope = to_slope * dot3(before, world), last_slope = to_slope * dot3(gradient, world);
    const real to_along = unit / MAX(length, (real)(1e-20f));
    const real3 change = add3(gradient, scale3(before, (real)(-1.0f)));
    const mask bent = both & (s->last_t < NOWHERE) & (length > 0.0f);
    const real apart = choose(bent, from - s->last_t, length), ratio = length / MAX(apart, (real)(1e-20f));
    const real bend = choose(bent & (apart > 0.0f), length / MAX(length + apart, (real)(1e-20f)), (real)(0.0f));
    const real3 turn = real3_of(bend * (change.x - ratio * (s->x - s->last_x)), bend * (change.y - ratio * (s->y - s->last_y)),
                                bend * (change.z - ratio * (s->z - s->last_z)));
    const mask free = shown | (s->shown > 0.0f);
    const real low = MIN(first, value), high = MAX(first, value), part = length / (float)count;
    for (int i = 0; i < count; ++i) {
        const float w = ((float)i + 0.5f) / (float)count, v = 1.0f - w;
        const real exact = first + w * w * (3.0f - 2.0f * w) * rise + w * v * (v * slope - w * last_slope);
        const real own = choose(free, exact, MIN(MAX(exact, low), high));
        color_t color = classify(&frame->transfer, sample->table, own);
        mask seen = both & (length > 0.0f) & (color.opacity > 0.0f) & !finished(s, frame);
        const real start = madd((real)((float)i), part, from), place = madd((real)(0.5f), part, start);
#if MISSING
        seen &= !missing_at(sample->missing, frame, sample->ray, place, seen);
#endif
        if (!any_lane(seen))
            continue;
        color_by(&color, coefficients, sample, place, seen);
        if (SHADED) {
            const real3 near = add3(add3(before, scale3(change, (real)(w))), scale3(turn, (real)(-w * v)));
            const real along = 6.0f * w * v * rise + v * (1.0f - 3.0f * w) * slope + w * (3.0f * w - 2.0f) * last_slope;
            const real more = along * to_along - dot3(near, world);
            color = shade(sample, color, add3(near, scale3(world, more)), own, place, seen);
        }
        absorb(s, color, log_light(color, part * frame->transfer.per_unit_distance), start, part, seen);
    }
}
