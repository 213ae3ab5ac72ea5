// Direct light that fibres scatter towards the viewer: the lobes of prt_bench/hair.py, seen from afar.
// `around` holds each lobe's share by azimuth (0 to π) and by the sine of the inclination of light that leaves (0 to 1), four
// layers a material; "generated/fibres" says how wide their longitudinal lobes are and how the fibres' scales tilt.
#include "generated/fibres"

layout(binding = 9) uniform sampler2DArray around;
uniform vec3 viewer;

// exp(−x) I₀(x) for x ≥ 0 (Abramowitz and Stegun, 9.8.1 and 9.8.2), right to 2e-7.
float scaled_bessel(float x) {
    if (x < 3.75) {
        float t = x * x / 14.0625;
        float series = 0.0360768 + t * 0.0045813;
        series = 3.0899424 + t * (1.2067492 + t * (0.2659732 + t * series));
        return exp(-x) * (1.0 + t * (3.5156229 + t * series));
    }
    float t = 3.75 / x;
    float series = -0.01647633 + t * 0.00392377;
    series = -0.00157565 + t * (0.00916281 + t * (-0.02057706 + t * (0.02635537 + t * series)));
    return (0.39894228 + t * (0.01328592 + t * (0.00225319 + t * series))) * inversesqrt(x);
}

// M(θ_i, θ_o): the exponents of the printed form add up to the squared chord between one direction and the other mirrored.
float longitudinal(vec2 into, vec2 from, float variance) {
    vec2 chord = vec2(into.x + from.x, into.y - from.y);
    float scale = variance * (1.0 - exp(-2.0 / variance));
    return scaled_bessel(into.y * from.y / variance) * exp(-0.5 * dot(chord, chord) / variance) / scale;
}

// Sine and cosine of an inclination turned by an angle, folded back at the poles.
vec2 turned(vec2 inclination, float angle) {
    float c = cos(angle), s = sin(angle);
    return vec2(inclination.x * c + inclination.y * s, abs(inclination.y * c - inclination.x * s));
}

// Radiance that leaves towards the viewer, W/m²/sr, from all emitters.
vec3 fibre_radiance(vec3 position, vec3 tangent, float clearance, int material) {
    const float pi = 3.14159265358979;
    vec3 towards = normalize(viewer - position);
    float sine = clamp(dot(towards, tangent), -1.0, 1.0);
    vec2 from = vec2(sine, sqrt(max(1.0 - sine * sine, 0.0)));
    vec3 across = towards - sine * tangent;
    vec4 variance = variances(material);
    float tilt = scale_tilt(material);
    vec2 leaving[4] = vec2[](turned(from, -2.0 * tilt), turned(from, tilt), turned(from, 4.0 * tilt), from);
    vec3 sum = vec3(0.0);
    for (int i = 0; i < emitter_count; ++i) {
        Emitter e = emitters[i];
        vec3 offset = e.position.xyz - position * e.position.w;
        float distance_squared = dot(offset, offset);
        vec3 direction = offset * inversesqrt(max(distance_squared, 1e-30));
        float strength = attenuation(e, direction, distance_squared);
        if (strength <= 0.0) continue;
#ifdef SHADOWS
        // From outside of the fibre's own tube, as if on a surface that faces the light.
        strength *= visibility(e, position + 2.0 * clearance * direction, direction, 1.0);
#endif
        float inclined = clamp(dot(direction, tangent), -1.0, 1.0);
        vec2 into = vec2(inclined, sqrt(max(1.0 - inclined * inclined, 0.0)));
        vec3 side = direction - inclined * tangent;
        float cosine = dot(side, across) * inversesqrt(max(dot(side, side) * dot(across, across), 1e-20));
        vec2 place = vec2(acos(clamp(cosine, -1.0, 1.0)) / pi, abs(sine));
        vec3 share = vec3(0.0);
        for (int p = 0; p < 4; ++p)
            share += longitudinal(into, leaving[p], variance[p]) * textureLod(around, vec3(place, 4 * material + p), 0.0).rgb;
        sum += strength * share * e.intensity.rgb;
    }
    return sum;
}
