#version 330
#include light.glsl
uniform sampler2D fine;
in vec3 position;
in vec3 normal;
in vec3 paint;
out vec4 colour;
void main() {
    vec4 grain = texture(fine, (position.yx + position.z * vec2(0.7, 0.6)) * 0.5);
    vec3 bent = normalize(normal + vec3((0.5 - grain.xy) * 1.2, 0.0));
    vec3 tint = paint * (0.6 + 0.8 * grain.z);
    vec3 lit = lighted(tint * tint, bent, sunlight(position));
    colour = vec4(sqrt(hazed(lit, position)), 0.0);
}
