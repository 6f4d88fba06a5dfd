// The part of a volume whose coefficients are resident: a brick.
//
// Stored coefficients, cells and samples of rays keep their numbers in the whole volume. So everything that depends on a number or
// a position is the same to the last bit, whichever part is resident. The pointer to the coefficients is offset to where the
// whole volume's first one would be (`whole_pointer`). A sample belongs to the window that contains it, a cell to the window that
// contains its number.
//
// Set by the host: WINDOWED; without it the whole volume is resident.

#if WINDOWED

// Stored coefficients along an axis, numbered in the whole volume: the first resident one, past the last, and past the volume's last.
#define STORED_FROM(frame, axis) (frame)->window.stored_from[axis]
#define STORED_TO(frame, extent, axis) (frame)->window.stored_to[axis]
#define WHOLE(frame, extent, axis) (frame)->window.whole[axis]
// The first cell of the first block of the pyramid.
#define BLOCKS_FROM(frame, axis) (frame)->window.blocks_from[axis]

INLINE global const float *whole_pointer(global const float *coefficients, const int4 extent, constant frame_t *frame)
{
    constant int *from = frame->window.stored_from;
    const size_t before = ((size_t)from[2] * extent.y + from[1]) * extent.x + from[0];
    return (global const float *)((size_t)coefficients - before * sizeof(float));
}

// How far, in samples, a ray along the faces of windows may stray.
#define ASTRAY 0.1f

// Rays that hardly change along an axis. Where such a ray crosses a face between two windows depends on rounding, and may not match
// the order of windows: along this axis it belongs to the window in which it enters.
INLINE mask along_faces(const ray_t *ray, const real direction) { return magnitude(direction) * (ray->leave - ray->enter) < ASTRAY; }

// Positions of samples at t along an axis, for windows: never behind the eye, as rounding near a face could place them, since
// windows are ordered outwards from the one that contains the eye.
INLINE real place_in_windows(constant frame_t *frame, const ray_t *ray, const real origin, const real direction, const float eye,
                             const real t)
{
    const real place = madd(choose(along_faces(ray, direction), ray->enter, t), direction, origin);
    return frame->camera.orthographic ? place : choose(direction > 0.0f, MAX(place, (real)(eye)), MIN(place, (real)(eye)));
}

// Whether samples at t are in the window: in exactly one window, since positions do not depend on it.
INLINE mask in_window(constant frame_t *frame, const ray_t *ray, const real t)
{
    constant float *eye = frame->camera.eye;
    const real3 p = real3_of(place_in_windows(frame, ray, ray->origin.x, ray->direction.x, eye[0], t),
                             place_in_windows(frame, ray, ray->origin.y, ray->direction.y, eye[1], t),
                             place_in_windows(frame, ray, ray->origin.z, ray->direction.z, eye[2], t));
    constant float *low = frame->window.low, *high = frame->window.high;
    return (p.x >= low[0]) & (p.x < high[0]) & (p.y >= low[1]) & (p.y < high[1]) & (p.z >= low[2]) & (p.z < high[2]);
}

#else

#define STORED_FROM(frame, axis) 0
#define STORED_TO(frame, extent, axis) ((axis) == 0 ? (extent).x : (axis) == 1 ? (extent).y : (extent).z)
#define WHOLE STORED_TO
#define BLOCKS_FROM(frame, axis) 0
#define whole_pointer(coefficients, extent, frame) (coefficients)

#endif
