#version 330
uniform mat4 clip_from_ned;
uniform mat4 ned_from_body;
in vec3 in_position;
void main() {
    gl_Position = clip_from_ned * ned_from_body * vec4(in_position, 1.0);
}
