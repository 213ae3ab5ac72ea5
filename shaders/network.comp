// Adds s · H n(x / s) to the coefficients: what a network knows beyond the linear map. s is the root mean square of the measured
// vector, found over its largest entry so that it neither overflows nor underflows. One workgroup; the layers are written for
// the shape in NETWORK.
#include "network.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Measured { vec4 measured[]; };
layout(std430, binding = 5) buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 11) readonly buffer Biases { float biases[]; };

shared vec3 terms[WORKGROUP];
shared vec3 activations[2][WIDEST];

vec3 over = vec3(0.0);  // 1 / s, and 0 in the dark

vec3 observed(uint m) { return measured[m].rgb * over; }

#include "generated/network"

void main() {
    uint lane = gl_LocalInvocationID.x;

    vec3 mine = vec3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) mine = max(mine, abs(measured[m].rgb));
    terms[lane] = mine;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) terms[lane] = max(terms[lane], terms[lane + half_size]);
        barrier();
    }
    vec3 largest = terms[0];
    barrier();
    vec3 scale = mix(largest, vec3(1.0), equal(largest, vec3(0.0)));

    mine = vec3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) {
        vec3 x = measured[m].rgb / scale;
        mine += x * x;
    }
    terms[lane] = mine;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) terms[lane] += terms[lane + half_size];
        barrier();
    }
    vec3 size = scale * sqrt(terms[0] / float(MEASUREMENTS));
    size = mix(size, vec3(0.0), equal(largest, vec3(0.0)));
    over = mix(1.0 / size, vec3(0.0), equal(size, vec3(0.0)));

    layers(lane, size);
}
