// Indirect irradiance at a lightmap coordinate, by the one kernel that is compiled in:
// RECONSTRUCT_BASIS    Σ_b u_b φ_b, four basis functions per RGBA layer
// RECONSTRUCT_SELECT   one stored column per channel, scaled
// RECONSTRUCT_LIGHTMAP the texture itself

layout(binding = 1) uniform sampler2DArray basis;

#ifndef RECONSTRUCT_LIGHTMAP
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
#endif

vec3 indirect_irradiance(vec2 uv) {
#if defined(RECONSTRUCT_BASIS)
    vec4 sum = vec4(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        mat4 block = mat4(coefficients[b], coefficients[b + 1], coefficients[b + 2], coefficients[b + 3]);
        sum += block * textureLod(basis, vec3(uv, layer), 0.0);
    }
    return sum.rgb;
#elif defined(RECONSTRUCT_SELECT)
    vec3 column;
    for (int c = 0; c < 3; ++c) {
        int choice = int(coefficients[1][c]);
        column[c] = textureLod(basis, vec3(uv, choice / 4), 0.0)[choice % 4];
    }
    return column * coefficients[0].rgb;
#elif defined(RECONSTRUCT_LIGHTMAP)
    return textureLod(basis, vec3(uv, 0.0), 0.0).rgb;
#endif
}
