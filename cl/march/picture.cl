// The end of rays: writes colours and guides to the picture.
//
// Set by the host: GUIDES, whether depths, normals, positions and shares of samples are written too.

#include "march/march.cl"

// The output pictures; unrequested ones are never written. Positions are relative to the volume's centre, which the host adds.
typedef struct { global float4 *rgba; global float *depth, *normals, *positions, *visited, *values; } pictures_t;

// The lanes of the packet at pixel (x, y) that are in the picture.
#define EACH_PIXEL(x, y)             \
    for (int i = 0; i < LANES; ++i)  \
        if ((x) + i % LANES_ACROSS < frame->picture.width && (y) + i / LANES_ACROSS < frame->picture.height)

// Light from 0 to 1 as it is shown: in sRGB (IEC 61966-2-1).
INLINE float3 as_shown(const float3 light)
{
    const float3 bright = 1.055f * pow(light, (float3)(1.0f / 2.4f)) - 0.055f;
    return light > 0.0031308f ? bright : 12.92f * light;
}

INLINE void store_pixel(constant frame_t *frame, const int x, const int y, float4 color, float t, float3 normal, float3 place,
                        const pictures_t *pictures)
{
    constant picture_block *picture = &frame->picture;
    const size_t pixel = (size_t)y * picture->width + x;
    global float4 *rgba = pictures->rgba + pixel;
    color.xyz *= color.w;
    color = picture->pass ? *rgba + color * picture->weight : color * picture->weight;
    if (picture->pass == picture->last_pass) {
        constant float *behind = color.w == 0.0f ? picture->background : picture->behind;
        const int light = picture->linear && color.w != 0.0f;   // of the background alone not even roundings change
        const float3 below = (float3)(behind[0], behind[1], behind[2]);
        color.xyz = picture->opaque ? color.xyz + (1.0f - color.w) * below : color.w > 0.0f ? color.xyz / color.w : (float3)(0.0f);
        color.w = picture->opaque ? 1.0f : color.w;
        color = color > 0.0f ? color < 1.0f ? color : (float4)(1.0f) : (float4)(0.0f);
        color.xyz = light ? as_shown(color.xyz) : color.xyz;
    }
    *rgba = color;
    if (GUIDES && picture->pass == 0) {
        pictures->depth[pixel] = t * frame->geometry.unit;
        vstore3(normal, pixel, pictures->normals);
        vstore3(place, pixel, pictures->positions);
    }
}

// The face of a cut that is nearest to a place: how far that is from it, and its normal.
typedef struct { real away; real3 normal; } face_t;

INLINE void nearer_face(face_t *face, const real distance, const real3 normal, const mask here)
{
    const mask nearer = here & (magnitude(distance) < face->away);
    face->away = choose(nearer, magnitude(distance), face->away);
    face->normal = real3_of(choose(nearer, normal.x, face->normal.x), choose(nearer, normal.y, face->normal.y), choose(nearer, normal.z, face->normal.z));
}

INLINE void nearer_face_of_box(face_t *face, const real3 at, constant float *low, constant float *high, const real off)
{
    mask within[3];   // of its extents along an axis
    for (int i = 0; i < 3; ++i) {
        const real place = axis_of(at, i);
        within[i] = (place >= low[i] - off) & (place <= high[i] + off);
    }
    for (int i = 0; i < 3; ++i) {
        const real3 normal = real3_of((real)(i == 0), (real)(i == 1), (real)(i == 2));
        const mask beside = within[i == 0 ? 1 : 0] & within[i == 2 ? 1 : 2];
        nearer_face(face, axis_of(at, i) - low[i], normal, beside);
        nearer_face(face, axis_of(at, i) - high[i], normal, beside);
    }
}

// In lanes that are on the face of a cut at t, up to rounding, its normal instead, towards the viewer.
INLINE real3 or_face_normals(constant frame_t *frame, const ray_t *ray, const real t, const mask active, const real3 normal)
{
    constant clip_block *clip = &frame->clip;
    const real3 at = matrix3(frame->geometry.index_to_world, at3(ray->origin, ray->direction, t));
    const float off = frame->planes.margin;
    face_t face = { (real)(off), normal };
    for (int i = 0; i < clip->planes; ++i) {
        constant float *plane = clip->plane + 4 * i;
        const real3 across = real3_of((real)(plane[0]), (real)(plane[1]), (real)(plane[2]));
        nearer_face(&face, dot3(at, across) - plane[3], across, active);
    }
    nearer_face_of_box(&face, at, clip->low, clip->high, (real)(off));
    for (int i = 0; i < clip->corners; ++i)
        nearer_face_of_box(&face, at, clip->corner + 6 * i, clip->corner + 6 * i + 3, (real)(off));
#if LABELS == 3   // rays may begin inside a region, on a face of the domain
    const real3 in = at3(ray->origin, ray->direction, t);
    constant geometry_block *geometry = &frame->geometry;
    for (int i = 0; i < 3; ++i) {
        const real3 one = real3_of((real)(i == 0), (real)(i == 1), (real)(i == 2));
        const real3 slope = transpose3(geometry->gradient, one);
        const real place = axis_of(in, i), away = MIN(magnitude(place - geometry->low[i]), magnitude(place - geometry->high[i]));
        nearer_face(&face, away, scale3(slope, 1.0f / square_root(dot3(slope, slope))), active);
    }
#endif
    const real3 facing = scale3(face.normal, choose(dot3(face.normal, ray->world) > 0.0f, (real)(-1.0f), (real)(1.0f)));
    const mask on = active & (face.away < off);
    return real3_of(choose(on, facing.x, normal.x), choose(on, facing.y, normal.y), choose(on, facing.z, normal.z));
}

// The normals at t, which face the viewer; NaN where there are none, as in lanes that are not active.
INLINE real3 normals_at(COEFFICIENTS coefficients, const sample_t *sample, const state_t *state, real t, mask active)
{
    real3 normal = real3_of((real)(NAN), (real)(NAN), (real)(NAN)), facing;
    real cosine;
    if (!any_lane(active))
        return normal;
    const ray_t *ray = sample->ray;
    const real at = choose(active, t, ray->enter);
    const real3 g = gradient_at(coefficients, sample, at, active);
    const mask known = active & !flat_or_normal(sample->frame, g, value_at(coefficients, sample, at, active), ray->world, &facing, &cosine);
    normal = real3_of(choose(known, facing.x, normal.x), choose(known, facing.y, normal.y), choose(known, facing.z, normal.z));
    const mask met = active & ON_FACE(state);
    if ((LABELS == 3 || sample->frame->clip.clipped) && FACES(sample->frame) && any_lane(met))
        normal = or_face_normals(sample->frame, ray, at, met, normal);
    return normal;
}

// Where rays are at t, counted from the volume's centre, in world units; NaN where they end nowhere.
INLINE real3 places_at(constant frame_t *frame, const ray_t *ray, const real t)
{
    const mask somewhere = t < NOWHERE;
    real3 place = real3_of((real)(NAN), (real)(NAN), (real)(NAN));
    if (GUIDES && any_lane(somewhere)) {
        const real3 p = scale3(from_center(frame, ray, choose(somewhere, t, ray->enter)), (real)(frame->geometry.unit));
        place = real3_of(choose(somewhere, p.x, place.x), choose(somewhere, p.y, place.y), choose(somewhere, p.z, place.z));
    }
    return place;
}

// Writes the rays of a packet to the picture: their colours, t, normals, places and the values that colours are of.
INLINE void store_packet(constant frame_t *frame, const ray_t *ray, const color_t color, real t, const real3 normal, const real3 place,
                         real value, real gathered, const int x, const int y, const pictures_t *pictures)
{
    const lanes_u red = { color.red }, green = { color.green }, blue = { color.blue }, opacity = { color.opacity }, depths = { t + ray->ahead };
    const lanes_u nx = { normal.x }, ny = { normal.y }, nz = { normal.z }, x_ = { place.x }, y_ = { place.y }, z_ = { place.z };
    EACH_PIXEL(x, y)
        store_pixel(frame, x + i % LANES_ACROSS, y + i / LANES_ACROSS, (float4)(red.each[i], green.each[i], blue.each[i], opacity.each[i]), depths.each[i],
                    (float3)(nx.each[i], ny.each[i], nz.each[i]), (float3)(x_.each[i], y_.each[i], z_.each[i]), pictures);
    if (GUIDES && frame->picture.pass == 0) {
        const real samples = ray->end - ray->begin + 1.0f + 2.0f * MARGIN;
        // parts of a ray (placed_ray) have more ends
        const lanes_u share = { choose(ray->hits & (samples > 0.0f), MIN(gathered / samples, (real)(1.0f)), (real)(NAN)) }, shown = { value };
        EACH_PIXEL(x, y) {
            const size_t pixel = (size_t)(y + i / LANES_ACROSS) * frame->picture.width + x + i % LANES_ACROSS;
            pictures->visited[pixel] = share.each[i];
            pictures->values[pixel] = shown.each[i];
        }
    }
}

// The end of the rays of a packet.
INLINE void finish_packet(COEFFICIENTS coefficients, const sample_t *sample, const state_t *state, real gathered, const int x,
                          const int y, const pictures_t *pictures)
{
    const real t = place_of(state);
    const color_t color = finish(state, coefficients, sample);
    real3 normal = normals_at(coefficients, sample, state, t, (t < NOWHERE) & (mask)(GUIDES ? ~0 : 0));
    real3 place = places_at(sample->frame, sample->ray, t);
#ifdef OWN_GUIDES
    OWN_GUIDES(state, coefficients, sample, &normal, &place);
#endif
    store_packet(sample->frame, sample->ray, color, t, normal, place, VALUE_OF(state, sample), gathered, x, y, pictures);
}

INLINE void finish_tile(const tile_t *tile, COEFFICIENTS coefficients, const int4 extent, constant frame_t *frame,
                        global const float4 *table, const pictures_t *pictures)
{
    plane_t none;   // no sample is being gathered
    none.usable = 0;
    for (int g = 0; g < PACKETS; ++g) {
        const int x = PACKET_X(tile->left, g), y = PACKET_Y(tile->top, g);
        sample_t sample = { frame, table, extent, tile->rays + g, &none, 0, 0.0f, 0 };
#if CAST
        sample.left = tile->cast->left[g];
#endif
        if (x < frame->picture.width && y < frame->picture.height)
            finish_packet(coefficients, &sample, tile->states + g, tile->gathered[g], x, y, pictures);
    }
}
