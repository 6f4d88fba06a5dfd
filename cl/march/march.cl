// THE ray loop. A work-item marches a tile of TILE_HEIGHT rows of TILE_WIDTH rays, in packets of LANES.
//
// All rays of a tile take the samples of one segment (segments.cl) before any takes the next. With PLANES they then share a
// blended plane for each sample number (plane.cl); rays that step along themselves, and planes whose footprint is too
// large, are sampled one by one.
//
// A mode (modes/*.cl, spliced in place of "mode.cl") supplies
//   state_t                       the state of LANES rays: STATE_FIELDS numbers for each
//   begin(state)                  before the first sample
//   gather(state, coefficients, sample, t, value, active)
//                                 one sample of the active lanes; returns the lanes that need no more
//   matters(state, frame, table, low, high, t, active)
//                                 whether a value from low to high, at t or past it, could change the result of any active lane
//   finished(state, frame)        the lanes that need no more samples, whatever these are: for states that are carried on
//   merge(front, back)            two stretches of the same rays, `back` behind `front`, into `front`
//   place_of(state)               the t of the result, or NOWHERE
//   finish(state, coefficients, sample)
//                                 the colour, not premultiplied
//   REACH                         samples between dependent samples, at most: a surface is between two; with 0 no sample at a missing
//                                 place is gathered, else all are, and what was found there is not shown (missing_at)
//   ANY_ORDER                     whether samples may be gathered in any order: then the segments where
//                                 PROMISE(low, high) is largest come first
//   STRETCHES                     1: instead of samples, which `gather` takes, the intervals between them are searched (walk.cl)
//   FACES(frame)                  whether it shows the faces of cuts; then also
//   ON_FACE(state)                the lanes whose place may be on a face
//   gather_face(state, coefficients, sample, value, active)
//                                 the face at which the active lanes enter; returns the lanes that need no more
//   SLOPES_MATTER(frame, table, bounds)
//                                 whether gradients as steep as bounds say could change a result, where `matters` may say so; then
//   SLOPES                        is 1
//   FACE_MATTERS(frame, low, high)
//                                 whether a face with a value from low to high could change a result, where `matters` may say no
//   VALUE_OF(state, sample)       the value that the colour is of, as it is stored (or, of no sample's unit, as it is): projections
//   OWN_GUIDES(state, coefficients, sample, normal, place)
//                                 what it writes in place of normals and positions
//   WHOLE_TILES                   1: where some ray of a tile needs samples all take theirs, for modes that seldom skip any
//   restart(state, active)        if samples are dependent (RESTARTS 1): the next ones lie behind a gap
//
// Set by the host: SLAB, LANES, TILE_WIDTH, TILE_HEIGHT, PLANES, ENDPOINTS, SHADED, CENTRAL, STATE_FIELDS, WINDOWED, MISSING,
// SEVERAL (whether samples lie on planes of another medium: rails), ADDED (whether they are added to a slab's: add.cl),
// FINISHED_THERE (whether a mode's `finish` reads coefficients, at place_of), and what is included.

// Twice as many rays if registers hold sixteen numbers. (Otherwise PoCL 3.0 aborts on float16 on some CPUs.)
#if LANES == 8 && TILE_HEIGHT % 2 == 0 && defined(__clang__) && defined(__AVX512F__)
#undef LANES
#define LANES 16
#endif

#include "base/platform.cl"
#include "base/lanes.cl"
#include "march/camera.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"
#include "march/sample.cl"
#include "mode.cl"

#ifndef FACES
#define FACES(frame) 0
#define ON_FACE(state) NONE
#define gather_face(state, coefficients, sample, value, active) ((void)(value), NONE)
#endif
#ifndef FACE_MATTERS
#define FACE_MATTERS(frame, low, high) 0
#endif
#ifndef WHOLE_TILES
#define WHOLE_TILES 0
#endif
#ifndef VALUE_OF
#define VALUE_OF(state, sample) ((real)(NAN))
#endif
#if !STRETCHES
#define LAYERED 0
#endif
#if !RESTARTS
#define restart(state, active)
#endif
#if !(CAST && LAYERED)
#define LAST_OF(state) (-NOWHERE)
#endif

#define PACKETS_ACROSS (TILE_WIDTH / LANES_ACROSS)
#define PACKETS (TILE_WIDTH * TILE_HEIGHT / LANES)

#include "march/segments.cl"
#if STRETCHES
#include "march/walk.cl"
#endif
#include "march/cast.cl"

// The x and y of a packet's first pixel.
#define PACKET_X(left, g) ((left) + (g) % PACKETS_ACROSS * LANES_ACROSS)
#define PACKET_Y(top, g) ((top) + (g) / PACKETS_ACROSS * LANES_DOWN)

// Where rays of a packet cross the picture, if that is listed: anywhere, roughly in the order of pixels.
INLINE void listed_places(constant frame_t *frame, const int x, const int y, global const float2 *places, real *px, real *py)
{
    lanes_u across, down;
    for (int i = 0; i < LANES; ++i) {
        const int column = MIN(x + i % LANES_ACROSS, frame->picture.width - 1), row = MIN(y + i / LANES_ACROSS, frame->picture.height - 1);
        const float2 place =
            places[(row - frame->picture.kept_from[1]) * frame->picture.kept[0] + column - frame->picture.kept_from[0]];
        across.each[i] = place.x;
        down.each[i] = place.y;
    }
    *px = across.all;
    *py = down.all;
}

// The rays of the tile whose first pixel is (left, top), or this part of them (pixel_ray). If the frame is listed, the picture is
// a list of rays, one for each pixel, which cross the real picture at `places`.
INLINE void aim_tile(tile_t *tile, constant frame_t *frame, const int left, const int top, global const float2 *places, const int part)
{
    tile->left = left;
    tile->top = top;
    tile->first = INFINITY;
    tile->last = -INFINITY;
    mask up = ~NONE, down = ~NONE;
    for (int g = 0; g < PACKETS; ++g) {
        const real x = PACKET_X(left, g) + LANE_X, y = PACKET_Y(top, g) + LANE_Y;
        real px = x + frame->picture.offset[0], py = y + frame->picture.offset[1];
        if (frame->picture.listed)
            listed_places(frame, PACKET_X(left, g), PACKET_Y(top, g), places, &px, &py);
        tile->rays[g] = pixel_ray(frame, px, py, part);
        const ray_t *ray = tile->rays + g;
        mask going = ray->hits & (x < (real)(frame->picture.width)) & (y < (real)(frame->picture.height));
#if CAST
        going &= tile->cast->on[g];
        if (tile->light >= 0)
            tile->rays[g] = light_ray(frame, tile->cast, tile->light, g, part, &going);
#endif
        tile->going[g] = going;
        const float low = min_lane(choose(going, ray->begin - MARGIN, NOWHERE)), high = max_lane(choose(going, ray->end + MARGIN, -NOWHERE));
        tile->first = MIN(low, tile->first);
        tile->last = MAX(high, tile->last);
        const real along = axis_of(ray->direction, frame->planes.axis);
        up &= (ray->planar & (along > 0.0f)) | !going;
        down &= (ray->planar & (along < 0.0f)) | !going;
    }
    tile->planar = PLANES && !frame->picture.listed && (!any_lane(!up) || !any_lane(!down));
#if SEVERAL
    tile->planar &= frame->rails.aligned;
#endif
    tile->way = any_lane(!up) ? -1.0f : 1.0f;
}

// The rays of a tile before their first sample.
INLINE void begin_tile(tile_t *tile, constant frame_t *frame, const int left, const int top, global const float2 *places)
{
    aim_tile(tile, frame, left, top, places, -1);
    for (int g = 0; g < PACKETS; ++g) {
        begin(tile->states + g);
        tile->gathered[g] = (real)(0.0f);
    }
}

#if PLANES
// The blend of plane number n under the tile.
OUT_OF_LINE void make_plane(plane_t *plane, COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame,
                            const int left, const int top, float way, float n)
{
    const int right = MIN(left + TILE_WIDTH, frame->picture.width) - 1, bottom = MIN(top + TILE_HEIGHT, frame->picture.height) - 1;
    float across = plane_at(&frame->planes, way, n);
#if SEVERAL
    across = madd(across, frame->rails.scale, frame->rails.shift);
#endif
    float2 u, v;
    plane->made = 1;
    if (tile_footprint(frame, left, top, right, bottom, way, across, &u, &v))
        plane_move(plane, coefficients, extent, frame, way, across, u.x, u.y, v.x, v.y);
}
#endif

// The position of sample number n of a packet: by multiplication, never accumulated.
INLINE real sample_t_of(const ray_t *ray, float n)
{
    const real t = madd(n, ray->step, ray->first);
    // the ends of a ray, moved slightly inside: on the face itself rounding would decide whether they are read outside
    const real inset = 1e-3f * ray->step;
    return ENDPOINTS ? MIN(MAX(t, ray->enter + inset), ray->leave - inset) : t;
}

#if !STRETCHES

// The value of a sample. Ends of rays are not on a plane, nor is the single sample of a ray between two planes.
INLINE real sample_value_of(COEFFICIENTS coefficients, global const ulong2 *sides, const sample_t *sample, real t, mask active)
{
#if LABELS == 3
    return name_at(coefficients, sides, sample, t, active);
#else
    const ray_t *ray = sample->ray;
    const float n = sample->number;
    real value = value_here(coefficients, sample, t, active);
    if (PLANES && sample->plane->usable && (ENDPOINTS | sample->apart)) {
        const mask apart = active & (ENDPOINTS ? (ray->begin > n) | (ray->end < n) : ray->alone);
        if (any_lane(apart))
            value = choose(apart, value_at(coefficients, sample, t, apart), value);
    }
    return value;
#endif
}

// Gathers samples number start to stop of the unfinished rays.
INLINE void take_samples(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, global const ulong2 *sides, constant frame_t *frame,
                         global const float4 *table, const mask wanted[PACKETS], const float start, const float stop MISSING_TOO)
{
    plane_t planes[SLAB];   // one per sample number, blended when the first packet needs it
    for (int i = 0; i < SLAB; ++i)
        planes[i].made = planes[i].usable = 0;
    for (int g = 0; g < PACKETS; ++g) {
        if (!any_lane(wanted[g]))
            continue;
        const ray_t *ray = tile->rays + g;
        state_t state = tile->states[g];
        real gathered = tile->gathered[g];
        mask going = tile->going[g];
        const int apart = any_lane(going & ray->alone);
        float n = start;
        for (plane_t *plane = planes; plane < planes + SLAB && n <= stop; ++plane, n += 1.0f) {
            mask active = lanes_within(ray, going, n, n);
            if (!any_lane(active))
                continue;
#if WINDOWED
            active &= in_window(frame, ray, sample_t_of(ray, n));
            if (!any_lane(active))
                continue;
#endif
#if MISSING
            if (REACH == 0.0f)
                active &= !missing_at(missing, frame, ray, sample_t_of(ray, n), active);
            if (!any_lane(active))
                continue;
#endif
#if PLANES
            // before and after the planes, where rays only have their ends, one may be past the stored coefficients
            if (tile->planar && !plane->made && n >= 0.0f && n < frame->planes.count)
                make_plane(plane, coefficients, extent, frame, tile->left, tile->top, tile->way, n);
#endif
            plane_sample_t on_plane;
            const sample_t sample = { frame, table, extent, ray, plane, &on_plane, n, apart AND_MISSING };
            const real t = sample_t_of(ray, n), value = sample_value_of(coefficients, sides, &sample, t, active);
            going = going & !gather(&state, coefficients, &sample, t, value, active);
            gathered += choose(active, (real)(1.0f), (real)(0.0f));
        }
        tile->states[g] = state;
        tile->gathered[g] = gathered;
        tile->going[g] = going;
    }
}

#endif

// Marches the rays of a tile through their samples.
INLINE void march_tile(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax,
                       global const ulong2 *sides, constant frame_t *frame, global const float4 *table MISSING_TOO)
{
    segments_t segments = segments_of(tile, minmax, frame, extent.w);
    while (next_segment(&segments, tile, minmax, frame, table, extent.w)) {
        const float start = segments.start, stop = segments.stop;
        mask wanted[PACKETS];
        for (int g = 0; g < PACKETS; ++g) {
            wanted[g] = lanes_within(tile->rays + g, tile->going[g], start, stop);
            if ((WHOLE_TILES ? 0 : PACKETS > 1) && frame->minmax.skipping && any_lane(wanted[g])) {
                const bounds_t bounds = bounds_of(minmax, frame, extent.w, tile, g, 1, start, stop);
                if (!packet_matters(frame, table, tile, g, &bounds, start, stop))
                    wanted[g] = NONE;
            }
        }
#if STRETCHES
        walk_segment(tile, coefficients, extent, sides, frame, table, wanted, start, stop AND_MISSING);
#else
        take_samples(tile, coefficients, extent, sides, frame, table, wanted, start, stop AND_MISSING);
#endif
    }
}

// The next part of the rays of a tile, where corners cut away leave several: false behind the last one. Its number is counted from 0;
// `part` begins with -1, and the rays are whole again at the end.
INLINE int next_part_of(tile_t *tile, constant frame_t *frame, global const float2 *places, int *part)
{
    const int corners = frame->clip.corners;
    int more = *part < 0;
    for (int g = 0; g < PACKETS && !more; ++g)
        more = any_lane(tile->rays[g].more & !finished(tile->states + g, frame));
    ++*part;
    if (corners) {
        aim_tile(tile, frame, tile->left, tile->top, places, more ? *part : -1);
        for (int g = 0; g < PACKETS; ++g)
            tile->going[g] &= !finished(tile->states + g, frame);
    }
    return more;
}

#if WINDOWED

// The interval of t in which rays may have samples in the window; empty if `enter` is past `leave`.
INLINE void stretch_in_window(constant frame_t *frame, const ray_t *ray, real *enter, real *leave)
{
    const float reserve = 2.0f * frame->window.margin + ASTRAY;
    constant float *low = frame->window.low, *high = frame->window.high;
    *enter = ray->enter;
    *leave = ray->leave;
    clip_axis(ray->origin.x, ray->direction.x, low[0] - reserve, high[0] + reserve, enter, leave);
    clip_axis(ray->origin.y, ray->direction.y, low[1] - reserve, high[1] + reserve, enter, leave);
    clip_axis(ray->origin.z, ray->direction.z, low[2] - reserve, high[2] + reserve, enter, leave);
}

// Keeps the rays of a tile that may have samples in the window, and of these the sample numbers that may be inside.
INLINE int enter_window(tile_t *tile, constant frame_t *frame)
{
    float first = INFINITY, last = -INFINITY;
    int some = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const ray_t *ray = tile->rays + g;
        real enter, leave;
        stretch_in_window(frame, ray, &enter, &leave);
        tile->going[g] &= enter <= leave;
        if (!any_lane(tile->going[g]))
            continue;
        some = 1;
        const mask apart = ray->alone;   // its step is 0
        const real per_step = 1.0f / choose(apart, (real)(1.0f), ray->step);
        const real from = choose(apart, ray->begin, round_down((enter - ray->first) * per_step) - 1.0f);
        const real to = choose(apart, ray->end, round_down((leave - ray->first) * per_step) + 2.0f);
        first = MIN(first, min_lane(choose(tile->going[g], from, NOWHERE)));
        last = MAX(last, max_lane(choose(tile->going[g], to, -NOWHERE)));
    }
    tile->first = MAX(tile->first, first);
    tile->last = MIN(tile->last, last);
    return some;
}

#endif

// Rays enter, or enter again behind a corner, those whose samples then have a number between `from` and `to`: the face of a cut is
// in front of all samples.
INLINE void enter_tile(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame, global const float4 *table,
                       const int part, const float from, const float to MISSING_TOO)
{
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    if (part == 0 && !(frame->clip.clipped && FACES(frame)))
        return;
    for (int g = 0; g < PACKETS; ++g) {
        const ray_t *ray = tile->rays + g;
        mask here = tile->going[g] & (ray->begin - MARGIN >= from) & (ray->begin - MARGIN <= to);
#if WINDOWED
        here &= in_window(frame, ray, ray->enter);
#endif
        if (part)
            restart(tile->states + g, ((ADDED & !WINDOWED) ? tile->going[g] : here) & (LAST_OF(tile->states + g) < ray->enter));   // of a slab no state is carried on
        if (!any_lane(here))
            continue;
        here &= ray->cut;
#if MISSING
        here &= !missing_at(missing, frame, ray, ray->enter, here);
#endif
        if (!FACES(frame) || !any_lane(here))
            continue;
        const sample_t sample = { frame, table, extent, ray, &none, 0, 0.0f, 0 AND_MISSING };
        const real value = value_at(coefficients, &sample, ray->enter, here);
        tile->going[g] &= !gather_face(tile->states + g, coefficients, &sample, value, here);
    }
}

#if CAST
#define EACH_CALL OUT_OF_LINE   // rays through pixels and those to lights share its code
#else
#define EACH_CALL INLINE
#endif

// Marches the rays of a tile through all their parts.
EACH_CALL void march_parts(tile_t *tile, COEFFICIENTS coefficients, const int4 extent, global const float2 *minmax,
                           global const ulong2 *sides, constant frame_t *frame, global const float4 *table,
                           global const float2 *places MISSING_TOO)
{
    for (int part = -1; next_part_of(tile, frame, places, &part);) {
        enter_tile(tile, coefficients, extent, frame, table, part, -INFINITY, INFINITY AND_MISSING);
        march_tile(tile, coefficients, extent, minmax, sides, frame, table AND_MISSING);
    }
}
