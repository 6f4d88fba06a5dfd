// The first root of LANES polynomials on 0..1, in Bernstein form: sum over j of q[j] C(n, j) u^j (1 - u)^(n - j).
//
// A number is below (negative) or not; a root is where a polynomial changes from one to the other. It has at most as many roots as
// its coefficients have such changes, and differs from that by an even number (Descartes' rule in this basis): none, or just one,
// is certain from the coefficients; several are separated by halving the interval from the left, so that no earlier one is missed.
//
// Set before: BERNSTEIN_DEGREE, n; BERNSTEIN_CHOOSE, the n + 1 binomials C(n, j).

#include "base/lanes.cl"

#define COEFFICIENT_COUNT (BERNSTEIN_DEGREE + 1)
#define NARROWEST 2e-7f   // of the interval: where float32 cannot separate positions, several roots count as one

constant float bernstein_choose[COEFFICIENT_COUNT] = BERNSTEIN_CHOOSE;

// The lanes whose coefficients change sides at least once, and at least twice.
typedef struct { mask once, twice; } changes_t;

INLINE changes_t changes_of(const real q[COEFFICIENT_COUNT])
{
    changes_t changes = { NONE, NONE };
#pragma unroll
    for (int j = 1; j <= BERNSTEIN_DEGREE; ++j) {
        const mask change = (q[j] < 0.0f) != (q[j - 1] < 0.0f);
        changes.twice |= change & changes.once;
        changes.once |= change;
    }
    return changes;
}

// Divides the interval at `c` (de Casteljau): `left` becomes its first part, and q the rest.
INLINE void split_at(real q[COEFFICIENT_COUNT], const real c, real left[COEFFICIENT_COUNT])
{
    left[0] = q[0];
#pragma unroll
    for (int k = 1; k <= BERNSTEIN_DEGREE; ++k) {
#pragma unroll
        for (int j = 0; j <= BERNSTEIN_DEGREE - k; ++j)
            q[j] = madd(c, q[j + 1] - q[j], q[j]);
        left[k] = q[0];
    }
}

INLINE void copy_polynomial(real to[COEFFICIENT_COUNT], const real from[COEFFICIENT_COUNT], const mask wanted)
{
#pragma unroll
    for (int j = 0; j <= BERNSTEIN_DEGREE; ++j)
        to[j] = choose(wanted, from[j], to[j]);
}

// Isolates the first root of the active lanes: q becomes the polynomial on a part of the interval, from `start` on and `width`
// long, in which it changes sides once. Returns the lanes that have a root.
OUT_OF_LINE mask first_change(real q[COEFFICIENT_COUNT], mask active, real *start, real *width)
{
    real rest[COEFFICIENT_COUNT], tail[COEFFICIENT_COUNT], left[COEFFICIENT_COUNT];
    real begin = (real)(0.0f), share = (real)(0.5f);   // where the rest begins; the part of it to examine next
    mask found = NONE;
    *start = begin;
    *width = (real)(1.0f);
#pragma unroll
    for (int j = 0; j <= BERNSTEIN_DEGREE; ++j)
        rest[j] = q[j];
    for (;;) {
        const changes_t all = changes_of(rest);
        const mask just_one = active & all.once & !all.twice;
        copy_polynomial(q, rest, just_one);
        *start = choose(just_one, begin, *start);
        *width = choose(just_one, 1.0f - begin, *width);
        found |= just_one;
        active &= all.twice;
        if (!any_lane(active))
            return found;
#pragma unroll
        for (int j = 0; j <= BERNSTEIN_DEGREE; ++j)
            tail[j] = rest[j];
        split_at(tail, share, left);
        const real part = share * (1.0f - begin);
        const changes_t first = changes_of(left);
        const mask here = active & first.once & (!first.twice | (part < NARROWEST)), none = !first.once;
        copy_polynomial(q, left, here);
        *start = choose(here, begin, *start);
        *width = choose(here, part, *width);
        found |= here;
        copy_polynomial(rest, tail, none);
        begin = choose(none, begin + part, begin);
        share = choose(none, MIN(2.0f * share, (real)(0.5f)), 0.5f * share);
        active &= !here & (1.0f - begin >= NARROWEST);   // the remaining interval is below float32's resolution
    }
}

INLINE real polynomial_at(const real scaled[COEFFICIENT_COUNT], const real u)
{
    const real v = 1.0f - u;
    real sum = scaled[0], power_of_u = (real)(1.0f);
#pragma unroll
    for (int j = 1; j <= BERNSTEIN_DEGREE; ++j) {
        power_of_u *= u;
        sum = madd(sum, v, scaled[j] * power_of_u);
    }
    return sum;
}

// The root of polynomials that change sides once on 0..1: regula falsi that halves the value of an end that stays (Illinois), and
// bisects every third time, until float32 cannot separate positions.
INLINE real root_between(const real q[COEFFICIENT_COUNT])
{
    real scaled[COEFFICIENT_COUNT];
#pragma unroll
    for (int j = 0; j <= BERNSTEIN_DEGREE; ++j)
        scaled[j] = q[j] * bernstein_choose[j];
    real low = (real)(0.0f), high = (real)(1.0f), at_low = q[0], at_high = q[BERNSTEIN_DEGREE], root = high;
    mask active = low < high, last_was_low = NONE, last_was_high = NONE;
    for (int i = 1; i < 60 && any_lane(active); ++i) {
        const real middle = 0.5f * (low + high), cut = low - at_low * (high - low) / (at_high - at_low);
        const mask between = (cut > low) & (cut < high);
        const real u = i % 3 == 0 ? middle : choose(between, cut, middle);
        const real value = polynomial_at(scaled, u);
        const mask is_low = (value < 0.0f) == (at_low < 0.0f);
        root = choose(active, u, root);
        at_high = choose(is_low & last_was_low, 0.5f * at_high, choose(is_low, at_high, value));
        at_low = choose((!is_low) & last_was_high, 0.5f * at_low, choose(is_low, value, at_low));
        low = choose(is_low, u, low);
        high = choose(is_low, high, u);
        last_was_low = is_low;
        last_was_high = !is_low;
        active &= (value != 0.0f) & (high - low > NARROWEST);
    }
    return root;
}
