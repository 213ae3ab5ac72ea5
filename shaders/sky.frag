// Radiance of an environment map behind the scene: equirectangular, y up, −z at the centre.
in vec2 screen;
out vec4 radiance;

layout(binding = 3) uniform sampler2D environment;
uniform mat4 from_screen;  // clip space to the map's frame, as directions from the camera

const float PI = 3.14159265358979;

void main() {
    vec4 far = from_screen * vec4(screen, 1.0, 1.0);
    vec3 d = normalize(far.xyz);
    vec2 uv = vec2(atan(d.x, -d.z) / (2.0 * PI) + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
    radiance = vec4(textureLod(environment, uv, 0.0).rgb, 1.0);
}
