#version 330
#include light.glsl
uniform sampler2D board;
uniform float side;
in vec3 position;
in vec2 place;
out vec4 colour;
void main() {
    vec3 tint = texture(board, vec2(place.y, -place.x) / side + 0.5).rgb;
    vec3 lit = lighted(tint * tint * 0.62, vec3(0.0, 0.0, -1.0), sunlight(position));
    colour = vec4(sqrt(hazed(lit, position)), 1.0);
}
