// Modes are written once, for one ray or for a row of LANES rays: `real` is float or a vector of them.

#if LANES == 1
typedef float real;
typedef int mask;
#define any_lane(m) (m)
inline real choose(mask m, real yes, real no) { return m ? yes : no; }
#else
typedef PASTE(float, LANES) real;
typedef PASTE(int, LANES) mask;
#define any_lane(m) any(m)
inline real choose(mask m, real yes, real no) { return select(no, yes, m); }
#endif

#define NONE ((mask)(0))
#define NOWHERE ((real)(INFINITY))

typedef struct { real x, y, z; } real3;

inline real3 real3_of(real x, real y, real z) { real3 v = { x, y, z }; return v; }
inline real dot3(real3 a, real3 b) { return madd(a.x, b.x, madd(a.y, b.y, a.z * b.z)); }
inline real3 add3(real3 a, real3 b) { return real3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
inline real3 scale3(real3 a, real s) { return real3_of(a.x * s, a.y * s, a.z * s); }
inline real3 at3(real3 origin, real3 direction, real t)
{
    return real3_of(madd(t, direction.x, origin.x), madd(t, direction.y, origin.y), madd(t, direction.z, origin.z));
}

// A row-major 3 x 3 matrix times a vector, and its transpose times one.
inline real3 matrix3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[1], v.y, m[2] * v.z)), madd(m[3], v.x, madd(m[4], v.y, m[5] * v.z)),
                    madd(m[6], v.x, madd(m[7], v.y, m[8] * v.z)));
}
inline real3 transpose3(constant float *m, real3 v)
{
    return real3_of(madd(m[0], v.x, madd(m[3], v.y, m[6] * v.z)), madd(m[1], v.x, madd(m[4], v.y, m[7] * v.z)),
                    madd(m[2], v.x, madd(m[5], v.y, m[8] * v.z)));
}
