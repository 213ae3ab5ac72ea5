// u = W [x; ‖x‖] per channel, or COUPLED: of all channels as one vector. One workgroup per basis function. The measured
// vector is divided by its largest entry first, so that the norm neither overflows nor underflows.
// GAMMA transfers the vector over its root mean square, along the curve, and keeps that size in the last coefficient.
#ifdef GAMMA
#include "gamma.glsl"
#endif

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Measured { vec4 measured[]; };
layout(std430, binding = 4) readonly buffer Weights { float weights[]; };  // [WEIGHT_CHANNELS, BASIS, COLUMNS + 1]
layout(std430, binding = 5) writeonly buffer Coefficients { vec4 coefficients[]; };

shared mat2x3 terms[WORKGROUP];

#ifdef COUPLED
const uint COLUMNS = 3 * MEASUREMENTS;  // the channel fastest

vec3 weight(uint b, uint m) {
    uint at = b * (COLUMNS + 1) + 3 * m;
    return vec3(weights[at], weights[at + 1], weights[at + 2]);
}

vec3 norm_weight(uint b) { return vec3(weights[b * (COLUMNS + 1) + COLUMNS]); }

vec3 over_channels(vec3 sum) { return vec3(sum.r + sum.g + sum.b); }
#else
const uint COLUMNS = MEASUREMENTS;

vec3 weight(uint b, uint m) {
    uint at = b * (COLUMNS + 1) + m;
#if WEIGHT_CHANNELS == 1
    return vec3(weights[at]);
#else
    const uint stride = BASIS * (COLUMNS + 1);
    return vec3(weights[at], weights[at + stride], weights[at + 2 * stride]);
#endif
}

vec3 norm_weight(uint b) { return weight(b, MEASUREMENTS); }

vec3 over_channels(vec3 sum) { return sum; }
#endif

mat2x3 total(mat2x3 mine) {
    uint lane = gl_LocalInvocationID.x;
    terms[lane] = mine;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) terms[lane] += terms[lane + half_size];
        barrier();
    }
    return terms[0];
}

vec3 greatest(vec3 mine) {
    uint lane = gl_LocalInvocationID.x;
    terms[lane][0] = mine;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) terms[lane][0] = max(terms[lane][0], terms[lane + half_size][0]);
        barrier();
    }
    vec3 found = terms[0][0];
    barrier();
    return found;
}

void main() {
    uint b = gl_WorkGroupID.x;
    uint lane = gl_LocalInvocationID.x;

    vec3 largest = vec3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) largest = max(largest, abs(measured[m].rgb));
    largest = greatest(largest);
#ifdef COUPLED
    largest = vec3(max(largest.r, max(largest.g, largest.b)));
#endif
    vec3 scale = mix(largest, vec3(1.0), equal(largest, vec3(0.0)));

#ifdef GAMMA
    mat2x3 squares = mat2x3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) {
        vec3 x = measured[m].rgb / scale;
        squares[1] += x * x;
    }
    vec3 size = sqrt(over_channels(total(squares)[1]) / float(COLUMNS));
    barrier();
    if (b == 0u && lane == 0u) coefficients[COEFFICIENTS - 1] = vec4(scale * size, 0.0);
    size = mix(size, vec3(1.0), equal(size, vec3(0.0)));
#endif

    mat2x3 sums = mat2x3(0.0);  // products and squares
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) {
        vec3 x = measured[m].rgb / scale;
#ifdef GAMMA
        x = curve(x / size);
#endif
        sums[0] += weight(b, m) * x;
        sums[1] += x * x;
    }
    sums = total(sums);
    if (lane == 0u) {
        vec3 u = over_channels(sums[0]) + norm_weight(b) * sqrt(over_channels(sums[1]));
#ifndef GAMMA
        u *= scale;
#endif
        coefficients[b] = vec4(u, 0.0);
    }
}
