// By how much what a sampler gives grows over 1 / 1024 of the way between two texels, 0 and 1, at 64 places: 256 times that.

uniform sampler3D probe;
out vec4 shown;

float sampled(float way) { return texture(probe, vec3(0.25 + 0.5 * way, 0.5, 0.5)).r; }

void main()
{
    float way = (floor(gl_FragCoord.x) + 0.37) / 64.0;
    shown = vec4(256.0 * (sampled(way + 1.0 / 1024.0) - sampled(way)));
}
