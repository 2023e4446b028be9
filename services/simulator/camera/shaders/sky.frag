#version 330
uniform mat3 ned_from_ray;
uniform vec3 to_sun;
in vec2 corner;
out vec4 colour;
const vec3 HAZE = vec3(0.62, 0.46, 0.33);
const vec3 ZENITH = vec3(0.40, 0.29, 0.22);
const vec3 GLOW = vec3(0.42, 0.50, 0.58);

float ridge(float azimuth) {
    float far = sin(azimuth * 3.0 + 1.0) * 0.6 + sin(azimuth * 7.0 + 0.3) * 0.4;
    float near = sin(azimuth * 23.0) * 0.16 + sin(azimuth * 51.0 + 2.0) * 0.09 + sin(azimuth * 113.0) * 0.035;
    return 0.030 + 0.040 * max(far, -0.3) + 0.022 * near;
}

void main() {
    vec3 ray = normalize(ned_from_ray * vec3(corner, 1.0));
    float up = -ray.z;
    vec3 sky = mix(HAZE, ZENITH, clamp(1.0 - exp(-3.2 * max(up, 0.0)), 0.0, 1.0));
    sky += GLOW * 0.35 * pow(max(dot(ray, to_sun), 0.0), 24.0);
    float height = ridge(atan(ray.y, ray.x));
    vec3 hills = mix(vec3(0.46, 0.31, 0.21), HAZE, 0.55 + 4.0 * max(up, 0.0));
    float above = smoothstep(height - 0.0012, height + 0.0012, up);
    colour = vec4(sqrt(mix(hills, sky, above)), 0.0);
}
