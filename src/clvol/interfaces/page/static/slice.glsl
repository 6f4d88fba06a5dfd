// A slice across an axis of the volume: values as grey, labels in their colours.

uniform vec3 corner, right, down;   // in samples, of a picture from (0, 0) to (1, 1)
uniform vec2 sliceSize, window_;     // pixels; the values of black and white

out vec4 pixel;

void main()
{
    vec2 at = vec2(gl_FragCoord.x, gl_FragCoord.y) / sliceSize;   // the first row that is read back is the top
    float here = exact(corner + at.x * right + at.y * down).w;
#if NAMES
    vec4 color = classified(here);
    pixel = vec4(color.a > 0.0 ? asShown(color.rgb) : vec3(0.0), 1.0);
#else
    pixel = vec4(vec3(clamp((here - window_.x) / (window_.y - window_.x), 0.0, 1.0)), 1.0);
#endif
}
