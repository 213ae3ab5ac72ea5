// Linear radiance to display: exposure, then the sRGB transfer function (IEC 61966-2-1). No other curve.
out vec4 colour;

layout(binding = 4) uniform sampler2D frame;
uniform float exposure;  // factor, not stops

void main() {
    vec3 v = clamp(texelFetch(frame, ivec2(gl_FragCoord.xy), 0).rgb * exposure, 0.0, 1.0);
    colour = vec4(mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, greaterThan(v, vec3(0.0031308))), 1.0);
}
