// Colours: the transfer function, and light.
//
// Set by the page: LINEAR, whether colours are computed in linear light; SHADED.

uniform sampler2D pieces;   // for each: colour and opacity where it begins; where it ends; its begin and length
uniform int count;

uniform vec4 material;      // ambient, diffuse, specular, shininess
uniform vec3 lights[4], lightColors[4], ahead;   // directions towards them; the sum of the headlights
uniform int directed;
uniform float zero;         // the value 0
uniform vec2 rounding;      // the largest gradient that counts as none: so much, and so much more for each unit of the value

vec3 asLight(vec3 c)
{
#if LINEAR
    return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, vec3(lessThanEqual(c, vec3(0.04045))));
#else
    return c;
#endif
}

vec3 asShown(vec3 c)
{
#if LINEAR
    return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, vec3(lessThanEqual(c, vec3(0.0031308))));
#else
    return c;
#endif
}

// The colour and opacity of a value: linear between its points, however many; a piece includes where it begins.
vec4 classified(float value)
{
    int low = 0, high = count - 1;
    while (low < high) {
        int middle = (low + high + 1) / 2;
        if (texelFetch(pieces, ivec2(2, middle), 0).x <= value)
            low = middle;
        else
            high = middle - 1;
    }
    vec2 span = texelFetch(pieces, ivec2(2, low), 0).xy;
    vec4 color = mix(texelFetch(pieces, ivec2(0, low), 0), texelFetch(pieces, ivec2(1, low), 0), clamp((value - span.x) / span.y, 0.0, 1.0));
    return vec4(asLight(color.rgb), color.a);
}

bool solid(float name) { return classified(name).a > 0.0; }

// Blinn-Phong, from both sides. `slope`: the gradient in the world; `along`: the direction of view there.
vec3 lit(vec3 color, vec3 slope, float value, vec3 along)
{
#if SHADED
    bool flat_ = length(slope) <= rounding.x + rounding.y * abs(value - zero);
    float facing = flat_ ? 0.0 : dot(slope, along) / length(slope), least = flat_ ? 1.0 : 0.0;
    vec3 normal = flat_ ? vec3(0.0) : slope * (facing > 0.0 ? -1.0 : 1.0) / length(slope), diffuse = vec3(material.x), shine = vec3(0.0);
    facing = abs(facing);
    for (int i = 0; i < directed; ++i) {
        vec3 half_ = lights[i] - along;
        float lambert = dot(normal, lights[i]), middle = (lambert + facing) * inversesqrt(max(dot(half_, half_), 1e-20));
        diffuse += lightColors[i] * material.y * max(lambert, least);
        if (lambert > 0.0)
            shine += lightColors[i] * material.z * pow(max(middle, 0.0), material.w);
    }
    diffuse += ahead * material.y * max(facing, least);
    if (facing > 0.0)
        shine += ahead * material.z * pow(facing, material.w);
    return color * diffuse + shine;
#else
    return color;
#endif
}
