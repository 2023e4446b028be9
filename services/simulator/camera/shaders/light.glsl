// Sun, sky light, shadows and haze. Colours are reflectances; the picture keeps their roots.
uniform vec3 to_sun;
uniform vec3 eye;
uniform mat4 shadow_from_ned;
uniform sampler2DShadow shadow_map;
uniform float shadow_bias;
uniform float haze_per_m;

const vec3 SUN = vec3(1.62, 1.50, 1.33);
const vec3 SKY = vec3(0.36, 0.33, 0.31);
const vec3 BOUNCE = vec3(0.17, 0.11, 0.07);
const vec3 HAZE = vec3(0.62, 0.46, 0.33);

float sunlight(vec3 position) {
    vec3 at = (shadow_from_ned * vec4(position, 1.0)).xyz * 0.5 + 0.5;
    float lit = texture(shadow_map, vec3(at.xy, at.z - shadow_bias));
    vec2 out_of_map = abs(at.xy - 0.5);
    return max(out_of_map.x, out_of_map.y) > 0.499 ? 1.0 : lit;
}

vec3 lighted(vec3 colour, vec3 normal, float sun_share) {
    float facing = max(dot(normal, to_sun), 0.0) * sun_share;
    return colour * (SUN * facing + mix(BOUNCE, SKY, 0.5 - 0.5 * normal.z));
}

vec3 hazed(vec3 colour, vec3 position) {
    float away = length(position - eye) * haze_per_m;
    return mix(colour, HAZE, 1.0 - exp(-away));
}
