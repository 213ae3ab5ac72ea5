// What a Phong lobe about the mirror direction reflects of direct light, W/m²/sr, from the K numbers of a texel; the same as
// prt_bench/glossy.py. BOUNCED adds what it reflects of surfaces under fixed light, from K numbers for each channel. FIXED reads the light's matrices, otherwise the triple product is taken here (DENSE: by its whole tensor).
#include "generated/harmonics"
#include "generated/lobe"
#if defined(FIXED)
#include "generated/bilinear"
#elif defined(DENSE)
#include "generated/dense_product"
#else
#include "generated/product"
#endif

#ifdef BOUNCED
vec3 gloss_of_surfaces(vec2 uv, float lobe_at[HARMONICS]) {
    float padded[4 * LAYERS];
    for (int k = 0; k < 4 * LAYERS; ++k) padded[k] = k < HARMONICS ? lobe_at[k] : 0.0;
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        vec4 four = vec4(padded[4 * layer], padded[4 * layer + 1], padded[4 * layer + 2], padded[4 * layer + 3]);
        for (int c = 0; c < 3; ++c) sum[c] += dot(four, stored(uv, BOUNCED + c * LAYERS + layer));
    }
    return sum;
}
#endif

// What reaches the lobe, of light that `visible` lets through.
vec3 gloss_of(float visible[HARMONICS], float lobe_at[HARMONICS]) {
#ifdef FIXED
    return bilinear(visible, lobe_at);
#else
    float q[HARMONICS];
    product(visible, lobe_at, q);
    vec3 sum = vec3(0.0);
    for (int k = 0; k < HARMONICS; ++k) sum += coefficients[k].rgb * q[k];
    return sum;
#endif
}

#ifndef ROWS
vec3 gloss(vec2 uv, vec3 mirror, float exponent) {
    float lobe_at[HARMONICS], transfer[4 * LAYERS];
    harmonics(mirror, lobe_at);
    lobe(exponent, lobe_at);
    for (int layer = 0; layer < LAYERS; ++layer) {
        vec4 four = stored(uv, VISIBLE + layer);
        transfer[4 * layer] = four.x;
        transfer[4 * layer + 1] = four.y;
        transfer[4 * layer + 2] = four.z;
        transfer[4 * layer + 3] = four.w;
    }
    float visible[HARMONICS];
    for (int k = 0; k < HARMONICS; ++k) visible[k] = transfer[k];
    vec3 sum = gloss_of(visible, lobe_at);
#if defined(BOUNCED) && !defined(FIXED)
    sum += gloss_of_surfaces(uv, lobe_at);
#endif
    return sum;
}
#endif
