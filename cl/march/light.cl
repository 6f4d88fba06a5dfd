// Blinn-Phong from the gradient, two-sided: the normal is the one that faces the viewer.

INLINE color_t shade(constant frame_t *frame, color_t color, real3 gradient, real3 world)
{
    const real squared = dot3(gradient, gradient);
    const mask flat = squared <= 1.0f;   // rounding, not a direction
    const real facing = dot3(gradient, world);
    // towards the viewer: against the ray
    const real3 normal = scale3(gradient, choose(facing > 0.0f, (real)(-1.0f), (real)(1.0f)) / square_root(choose(flat, (real)(1.0f), squared)));
    real red = (real)(frame->ambient), green = red, blue = red, shine_red = (real)(0.0f), shine_green = shine_red, shine_blue = shine_red;
    for (int i = 0; i < frame->lights; ++i) {
        constant float *light = frame->light + 8 * i;   // direction, 1 for a headlight; colour
        const real3 to = light[3] != 0.0f ? scale3(world, (real)(-1.0f))
                                          : real3_of((real)(light[0]), (real)(light[1]), (real)(light[2]));
        const real lambert = choose(flat, (real)(1.0f), MAX(dot3(normal, to), (real)(0.0f)));
        real half_angle = lambert;   // a headlight's half-way direction is the viewer's
        if (light[3] == 0.0f) {
            const real3 sum = add3(to, scale3(world, (real)(-1.0f)));
            half_angle = MAX(dot3(normal, sum) / square_root(MAX(dot3(sum, sum), (real)(1e-20f))), (real)(0.0f));
        }
        half_angle = choose(flat, (real)(0.0f), half_angle);
        const real diffuse = frame->diffuse * lambert;
        const real shine = choose(lambert > 0.0f, frame->specular * power(half_angle, frame->shininess, frame->whole_shininess, frame->least_shine), (real)(0.0f));
        red += diffuse * light[4]; green += diffuse * light[5]; blue += diffuse * light[6];
        shine_red += shine * light[4]; shine_green += shine * light[5]; shine_blue += shine * light[6];
    }
    color.red = madd(color.red, red, shine_red);
    color.green = madd(color.green, green, shine_green);
    color.blue = madd(color.blue, blue, shine_blue);
    return color;
}
