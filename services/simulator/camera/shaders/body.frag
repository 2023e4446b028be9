#version 330
#include light.glsl
uniform float moves;
in vec3 position;
in vec3 normal;
in vec3 paint;
out vec4 colour;
void main() {
    vec3 lit = lighted(paint * paint, normalize(normal), sunlight(position));
    colour = vec4(sqrt(hazed(lit, position)), moves);
}
