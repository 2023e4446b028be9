#version 330
// What moved across each pixel during the exposure: the picture's own colours along the path of what is there.
uniform sampler2D sharp;
uniform sampler2D depth;
uniform int taps;
uniform mat4 begin_from_clip;
uniform mat4 end_from_clip;
uniform vec4 w_ned_from_clip;
uniform vec4 rover_in_begin;
uniform vec4 rover_in_end;
in vec2 corner;
out vec4 colour;
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 clip = vec4(corner, texelFetch(depth, pixel, 0).r * 2.0 - 1.0, 1.0);
    float on_rover = texelFetch(sharp, pixel, 0).a * dot(w_ned_from_clip, clip);
    vec4 first = begin_from_clip * clip - on_rover * rover_in_begin;
    vec4 last = end_from_clip * clip + on_rover * rover_in_end;
    vec2 path = 0.5 * (last.xy / last.w - first.xy / first.w);
    vec2 stride = path / float(taps);
    vec2 at = corner * 0.5 + 0.5 - 0.5 * path + 0.5 * stride;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < taps; i++) {
        vec3 tap = texture(sharp, at).rgb;
        sum += tap * tap;
        at += stride;
    }
    colour = vec4(sqrt(sum / float(taps)), 1.0);
}
