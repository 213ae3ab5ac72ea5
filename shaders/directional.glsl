// What a Phong lobe about the mirror direction reflects, W/m²/sr: of indirect light from nine coefficients a texel, the same as
// prt_bench/glossy_indirect.py, and DIRECT of emitters, each by itself. Whoever includes it has the generated harmonics and lobe.

layout(binding = 6) uniform sampler2DArray arriving;

vec3 gloss(vec2 uv, vec3 mirror, float exponent) {
    float lobe_at[9];
    harmonics(mirror, lobe_at);
    lobe(exponent, lobe_at);
    vec3 sum = vec3(0.0);
    for (int k = 0; k < 9; ++k) sum += lobe_at[k] * textureLod(arriving, vec3(uv, k), 0.0).rgb;
    return sum;
}

#ifdef DIRECT
vec3 gloss_of_emitters(vec3 position, vec3 normal, vec3 mirror, float exponent) {
    vec3 sum = vec3(0.0);
    for (int i = 0; i < emitter_count; ++i) {
        Emitter e = emitters[i];
        vec3 offset = e.position.xyz - position * e.position.w;
        float distance_squared = dot(offset, offset);
        vec3 direction = offset * inversesqrt(max(distance_squared, 1e-30));
        float incidence = max(dot(normal, direction), 0.0);
        float aligned = max(dot(mirror, direction), 0.0);
        float strength = incidence * attenuation(e, direction, distance_squared) * pow(aligned, exponent);
        if (strength > 0.0) {
#ifdef SHADOWS
            strength *= visibility(e, position, normal, incidence);
#endif
            sum += strength * e.intensity.rgb;
        }
    }
    return (exponent + 1.0) / 6.28318530717959 * sum;
}
#endif
