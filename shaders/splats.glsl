// What splats left on the screen, over the sum of their weights. Where none reaches, as on slivers that no sample lies on, light
// of the nearest pixels around that have some.
layout(binding = 9) uniform sampler2D splat_light;
layout(binding = 10) uniform sampler2D splat_shadow;

const int FARTHEST = 32;  // pixels

vec3 splatted(sampler2D sums) {
    ivec2 here = ivec2(gl_FragCoord.xy), last = textureSize(sums, 0) - 1;
    vec4 sum = texelFetch(sums, here, 0);
    for (int away = 1; sum.a == 0.0 && away <= FARTHEST; away *= 2) {
        for (int i = 0; i < 9; ++i) sum += texelFetch(sums, clamp(here + away * ivec2(i % 3 - 1, i / 3 - 1), ivec2(0), last), 0);
    }
    return sum.rgb / max(sum.a, 1e-12);
}

vec3 splatted_light() { return splatted(splat_light); }

// Share of direct light that arrives, in each channel.
vec3 splatted_share() { return splatted(splat_shadow); }
