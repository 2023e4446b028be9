#version 330
uniform mat4 clip_from_ned;
uniform mat4 ned_from_body;
in vec3 in_position;
in vec3 in_normal;
in vec3 in_colour;
out vec3 position;
out vec3 normal;
out vec3 paint;
out vec2 place;
void main() {
    vec4 world = ned_from_body * vec4(in_position, 1.0);
    position = world.xyz;
    normal = mat3(ned_from_body) * in_normal;
    paint = in_colour;
    place = in_position.xy;
    gl_Position = clip_from_ned * world;
}
