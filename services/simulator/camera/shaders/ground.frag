#version 330
#include light.glsl
uniform sampler2D coarse;
uniform sampler2D fine;
uniform float coarse_per_m;
uniform vec2 fine_per_m;
in vec3 position;
in vec3 normal;
out vec4 colour;
void main() {
    vec3 tint = texture(coarse, position.yx * coarse_per_m).rgb;
    vec4 a = texture(fine, position.yx * fine_per_m.x);
    vec4 b = texture(fine, position.yx * fine_per_m.y + 0.37);
    vec2 slope = (a.xy - 0.5) * 2.0 + (b.xy - 0.5) * 1.3;
    vec3 bent = normalize(normal + vec3(-slope, 0.0));
    float tone = 4.0 * a.z * b.z;
    tint *= tone;
    float sun_share = sunlight(position) * min(a.w, b.w);
    vec3 lit = lighted(tint * tint, bent, sun_share);
    colour = vec4(sqrt(hazed(lit, position)), 0.0);
}
