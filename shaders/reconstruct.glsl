// Indirect irradiance at a lightmap coordinate, by the one kernel that is compiled in:
// RECONSTRUCT_BASIS    Σ_b u_b φ_b, four basis functions per RGBA layer
// RECONSTRUCT_CLUSTERS the same with CLUSTER_BASIS functions and coefficients of a texel's own cluster, see clusters.glsl
// RECONSTRUCT_COUPLED  the same with a basis for each channel, one channel's layers after another's
// RECONSTRUCT_CHANNELS the same layout, each channel with coefficients of its own
// RECONSTRUCT_SELECT   one stored column per channel, scaled
// RECONSTRUCT_LIGHTMAP the texture itself
// RECONSTRUCT_VERTICES what was found at the vertices, interpolated by the rasteriser
// RECONSTRUCT_FIELD    Σ_b u_b φ_b, the functions from a network of the place on the surface
// RECONSTRUCT_SPLATS   what the splats of samples left on the screen
// BOUNCED adds what surfaces send under fixed light: for each channel, harmonics in layers from this one on.
// TILTED has in three layers more how light changes with the normal, along each axis.
// MIPS reads halved images where a frame shows many texels in a pixel.
// GAMMA takes the sum back along the curve, times the size in the last coefficient.
#ifdef GAMMA
#include "gamma.glsl"
#endif

#ifdef RECONSTRUCT_VERTICES
in vec3 vertex_light;
#elif defined(RECONSTRUCT_SPLATS)
#include "splats.glsl"
#else
layout(binding = 1) uniform sampler2DArray basis;

vec4 stored(vec2 uv, int layer) {
#ifdef MIPS
    return texture(basis, vec3(uv, layer));
#else
    return textureLod(basis, vec3(uv, layer), 0.0);
#endif
}
#endif

#if !defined(RECONSTRUCT_LIGHTMAP) && !defined(RECONSTRUCT_VERTICES) && !defined(RECONSTRUCT_SPLATS)
layout(std140, binding = 0) uniform Coefficients { vec4 coefficients[COEFFICIENTS]; };
#endif

#ifdef RECONSTRUCT_FIELD
#include "field.glsl"
#endif
#ifdef RECONSTRUCT_CLUSTERS
#include "clusters.glsl"
#endif

vec3 reconstruction(vec2 uv) {
#if defined(RECONSTRUCT_BASIS)
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        mat4x3 block = mat4x3(coefficients[b].rgb, coefficients[b + 1].rgb, coefficients[b + 2].rgb, coefficients[b + 3].rgb);
        sum += block * stored(uv, layer);
    }
#ifdef BOUNCED
    const float sqrt_4pi = 3.5449077018110318;
    for (int c = 0; c < 3; ++c) sum[c] += sqrt_4pi * stored(uv, BOUNCED + c * LAYERS).x;
#endif
    return sum;
#elif defined(RECONSTRUCT_CLUSTERS)
    return clustered_light(uv);
#elif defined(RECONSTRUCT_COUPLED)
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        vec4 u = vec4(coefficients[b].r, coefficients[b + 1].r, coefficients[b + 2].r, coefficients[b + 3].r);
        for (int c = 0; c < 3; ++c) sum[c] += dot(u, stored(uv, c * LAYERS + layer));
    }
    return sum;
#elif defined(RECONSTRUCT_CHANNELS)
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        mat4x3 u = mat4x3(coefficients[b].rgb, coefficients[b + 1].rgb, coefficients[b + 2].rgb, coefficients[b + 3].rgb);
        mat3x4 by_channel = transpose(u);
        for (int c = 0; c < 3; ++c) sum[c] += dot(by_channel[c], stored(uv, c * LAYERS + layer));
    }
    return sum;
#elif defined(RECONSTRUCT_SELECT)
    vec3 column;
    for (int c = 0; c < 3; ++c) {
        int choice = int(coefficients[1][c]);
        column[c] = stored(uv, choice / 4)[choice % 4];
    }
    return column * coefficients[0].rgb;
#elif defined(RECONSTRUCT_LIGHTMAP)
    return stored(uv, 0).rgb;
#elif defined(RECONSTRUCT_VERTICES)
    return vertex_light;
#elif defined(RECONSTRUCT_FIELD)
    return field_light();
#elif defined(RECONSTRUCT_SPLATS)
    return splatted_light();
#endif
}

vec3 indirect_irradiance(vec2 uv) {
#ifdef GAMMA
    return coefficients[COEFFICIENTS - 1].rgb * uncurve(reconstruction(uv));
#else
    return reconstruction(uv);
#endif
}

#ifdef TILTED
vec3 change_by_tilt(vec2 uv, vec3 tilt) {
    return tilt.x * stored(uv, 1).rgb + tilt.y * stored(uv, 2).rgb + tilt.z * stored(uv, 3).rgb;
}
#endif
