// What splats left on the screen, over the sum of their weights; nothing where none reaches.
layout(binding = 9) uniform sampler2D splat_light;
layout(binding = 10) uniform sampler2D splat_shadow;

vec3 splatted_light() {
    vec4 sum = texelFetch(splat_light, ivec2(gl_FragCoord.xy), 0);
    return sum.rgb / max(sum.a, 1e-12);
}

// Share of direct light that arrives, in each channel.
vec3 splatted_share() {
    vec4 sum = texelFetch(splat_shadow, ivec2(gl_FragCoord.xy), 0);
    return sum.rgb / max(sum.a, 1e-12);
}
