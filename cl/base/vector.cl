// Vectors of three numbers, LANES of them at a time, and 3 × 3 matrices.

#include "base/lanes.cl"

typedef struct { real x, y, z; } real3;

INLINE real3 real3_of(real x, real y, real z) { real3 v = { x, y, z }; return v; }
INLINE real dot3(real3 a, real3 b) { return madd(a.x, b.x, madd(a.y, b.y, a.z * b.z)); }
INLINE real3 add3(real3 a, real3 b) { return real3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
INLINE real3 scale3(real3 a, real s) { return real3_of(a.x * s, a.y * s, a.z * s); }
INLINE real3 at3(real3 origin, real3 direction, real t)
{
    return real3_of(madd(t, direction.x, origin.x), madd(t, direction.y, origin.y), madd(t, direction.z, origin.z));
}

// A row-major 3 x 3 matrix times a vector, and its transpose times one.
INLINE real3 matrix3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[1], v.y, m[2] * v.z)), madd(m[3], v.x, madd(m[4], v.y, m[5] * v.z)),
                    madd(m[6], v.x, madd(m[7], v.y, m[8] * v.z)));
}
INLINE real3 transpose3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[3], v.y, m[6] * v.z)), madd(m[1], v.x, madd(m[4], v.y, m[7] * v.z)),
                    madd(m[2], v.x, madd(m[5], v.y, m[8] * v.z)));
}
