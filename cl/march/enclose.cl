// Where rays leave a region: the boundary between two places on them is guessed, then enclosed.

#include "march/sample.cl"

#define GUESSES 3   // before a boundary is enclosed

OUT_OF_LINE float lead_one(COEFFICIENTS coefficients, const sample_t *sample, float x, float y, float z, const int one, const int other)
{
    const region_taps_t taps = taps_around(coefficients, sample->extent, locate_stored(sample, x, y, z));
    return weight_of(&taps, one) - weight_of(&taps, other);
}

// By how much the weight of one label exceeds that of another.
INLINE real lead_at(COEFFICIENTS coefficients, const sample_t *sample, const real t, const real one, const real other, const mask active)
{
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active }, ones = { to_mask(one) }, others = { to_mask(other) };
    lanes_u lead = { (real)(0.0f) };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i])
            lead.each[i] = lead_one(coefficients, sample, x.each[i], y.each[i], z.each[i], ones.each[i], others.each[i]);
    return lead.all;
}

// A guess of where one label's lead over another is lost: regula falsi that halves the value of an end that stays (Illinois).
INLINE real lead_lost(COEFFICIENTS coefficients, const sample_t *sample, real near, real far, const real one, const real other, const mask active)
{
    real ahead = lead_at(coefficients, sample, near, one, other, active), behind = lead_at(coefficients, sample, far, one, other, active);
    mask stayed = NONE;   // 1: the far end did, 2: the near one
    for (int i = 0;; ++i) {
        const real cut = near + (far - near) * (ahead / (ahead - behind));
        const real guess = choose((cut > near) & (cut < far), cut, 0.5f * (near + far));
        if (i == GUESSES)
            return guess;
        const real lead = lead_at(coefficients, sample, guess, one, other, active);
        const mask on = lead > 0.0f;
        behind = choose(on & (stayed == 1), 0.5f * behind, choose(on, behind, lead));
        ahead = choose(!on & (stayed == 2), 0.5f * ahead, choose(on, lead, ahead));
        stayed = choose_whole(on, (mask)(1), (mask)(2));
        near = choose(on, guess, near);
        far = choose(on, far, guess);
    }
}

// From `near`, in the region of `label`, to `far`, in that of `entered`: the first boundary found, within `close`. `far` is then behind it,
// and `entered` the label there.
INLINE void enclose(COEFFICIENTS coefficients, const sample_t *sample, const real label, real near, const real close, real *far, real *entered,
                    const mask active)
{
    const real guess = lead_lost(coefficients, sample, near, *far, label, *entered, active);
    mask apart = active;
    for (int i = 0;; ++i) {
        // close by on both sides of the guess, which ends it unless a third label is there
        const real beside = guess + (i ? 0.49f : -0.49f) * close;
        const real middle = choose((mask)(i < 2 ? ~0 : 0) & (beside > near) & (beside < *far), beside, 0.5f * (near + *far));
        apart &= (*far - near > close) & (middle > near) & (middle < *far);
        if (!any_lane(apart))
            return;
        const real there = value_at(coefficients, sample, middle, apart);
        const mask before = there == label;
        near = choose(apart & before, middle, near);
        *far = choose(apart & !before, middle, *far);
        *entered = choose(apart & !before, there, *entered);
    }
}
