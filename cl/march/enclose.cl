// Where rays leave a region: the place on them where another one takes the lead, and if a third one may lead there, it is enclosed.

#include "march/sample.cl"

#define MOST_STEPS 20
#define SMOOTH (DEGREE > 2)   // else slopes bend between cells
#define THIRD 0.667f   // of all weight: where two labels hold more and tie, no other one leads

// Where the lead of the label `entered` over another begins, and its gradient there; whether no third one leads.
typedef struct { float t; gradient_t gradient; int sure; } lead_found_t;

// Newton's method in an interval at whose end the label leads. `close`: how far off the place may be.
OUT_OF_LINE lead_found_t lead_found(COEFFICIENTS coefficients, const sample_t *sample, const float3 origin, const float3 direction, float near,
                                    float far, const int label, const int entered, const float close)
{
    lead_found_t found;
    float t = 0.5f * (near + far), before = 0.0f, gradient[3], both = 0.0f;
    cell_t last = { -1, -1, -1, 0.0f, 0.0f, 0.0f };
    int done = 0;
    for (int i = 0; i < MOST_STEPS; ++i) {
        const cell_t c = locate_stored(sample, madd(t, direction.x, origin.x), madd(t, direction.y, origin.y), madd(t, direction.z, origin.z));
        const int same = c.x == last.x && c.y == last.y && c.z == last.z;
        if (done && same)
            break;
        const region_taps_t taps = taps_around(coefficients, sample->extent, c);
        const float lead = lead_between(&taps, c, entered, label, gradient, &both);
        const float slope = gradient[0] * direction.x + gradient[1] * direction.y + gradient[2] * direction.z;
        near = lead < 0.0f ? t : near;
        far = lead < 0.0f ? far : t;
        const float next = t - lead / slope, middle = 0.5f * (near + far);
        const int inside = next >= near && next <= far;
        const float step = inside ? fabs(next - t) : fabs(middle - t);
        t = inside ? next : middle;
        // errors are squared: relative to the steps, the next one is about this
        done = step <= 10.0f * close && (step * step * step <= 0.3f * close * before * before || step < 0.01f * close);
        before = inside && (SMOOTH || same) ? step : 0.0f;
        last = c;
    }
    found.t = t;
    found.gradient = scaled_lead(entered, gradient);
    found.sure = both > THIRD;
    return found;
}

// From `near`, in the region of `label`, to `far`, in that of `entered`: the first boundary found, within `close`. `far` is then there or
// behind it, `entered` the label behind, and `gradient` that of its lead.
INLINE void enclose(COEFFICIENTS coefficients, const sample_t *sample, const real label, real near, const real close, real *far, real *entered,
                    real3 *gradient, const mask active)
{
    const ray_t *ray = sample->ray;
    const lanes_u ox = { ray->origin.x }, oy = { ray->origin.y }, oz = { ray->origin.z };
    const lanes_u dx = { ray->direction.x }, dy = { ray->direction.y }, dz = { ray->direction.z };
    const lanes_u from = { near }, to = { *far }, off = { close };
    const lane_masks_u wanted = { active }, left = { to_mask(label) }, others = { to_mask(*entered) };
    lanes_u gx = { (real)(0.0f) }, gy = gx, gz = gx, place = { *far };
    lane_masks_u unsure = { NONE };
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i]) {
            const float3 origin = (float3)(ox.each[i], oy.each[i], oz.each[i]), direction = (float3)(dx.each[i], dy.each[i], dz.each[i]);
            const lead_found_t found = lead_found(coefficients, sample, origin, direction, from.each[i], to.each[i], left.each[i], others.each[i], off.each[i]);
            place.each[i] = found.t;
            unsure.each[i] = found.sure ? 0 : ~0;
            gx.each[i] = found.gradient.x; gy.each[i] = found.gradient.y; gz.each[i] = found.gradient.z;
        }
    *gradient = transpose3(sample->frame->geometry.gradient, real3_of(gx.all, gy.all, gz.all));
    const mask third = active & unsure.all;
    mask apart = third;
    *far = choose(third, *far, place.all);
    for (int i = 0; any_lane(apart); ++i) {
        // close by on both sides of the guess, which ends it unless a third label is there
        const real beside = place.all + (i ? 0.49f : -0.49f) * close;
        const real middle = choose((mask)(i < 2 ? ~0 : 0) & (beside > near) & (beside < *far), beside, 0.5f * (near + *far));
        apart &= (*far - near > close) & (middle > near) & (middle < *far);
        const real there = any_lane(apart) ? value_at(coefficients, sample, middle, apart) : (real)(0.0f);
        const mask before = there == label;
        near = choose(apart & before, middle, near);
        *far = choose(apart & !before, middle, *far);
        *entered = choose(apart & !before, there, *entered);
    }
    if (SHADED && any_lane(third)) {
        const real3 own = gradient_at(coefficients, sample, *far, third);
        *gradient = real3_of(choose(third, own.x, gradient->x), choose(third, own.y, gradient->y), choose(third, own.z, gradient->z));
    }
}
