// u = W [x; ‖x‖] per channel: one workgroup per basis function. The measured vector is divided by its largest entry first,
// so that the norm neither overflows nor underflows.

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Measured { vec4 measured[]; };
layout(std430, binding = 4) readonly buffer Weights { float weights[]; };  // [WEIGHT_CHANNELS, BASIS, MEASUREMENTS + 1]
layout(std430, binding = 5) writeonly buffer Coefficients { vec4 coefficients[]; };

shared vec3 products[WORKGROUP];
shared vec3 squares[WORKGROUP];

vec3 weight(uint b, uint m) {
    uint at = b * (MEASUREMENTS + 1) + m;
#if WEIGHT_CHANNELS == 1
    return vec3(weights[at]);
#else
    const uint stride = BASIS * (MEASUREMENTS + 1);
    return vec3(weights[at], weights[at + stride], weights[at + 2 * stride]);
#endif
}

void main() {
    uint b = gl_WorkGroupID.x;
    uint lane = gl_LocalInvocationID.x;

    vec3 largest = vec3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) largest = max(largest, abs(measured[m].rgb));
    products[lane] = largest;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) products[lane] = max(products[lane], products[lane + half_size]);
        barrier();
    }
    vec3 scale = mix(products[0], vec3(1.0), equal(products[0], vec3(0.0)));
    barrier();

    vec3 product = vec3(0.0), square = vec3(0.0);
    for (uint m = lane; m < MEASUREMENTS; m += WORKGROUP) {
        vec3 x = measured[m].rgb / scale;
        product += weight(b, m) * x;
        square += x * x;
    }
    products[lane] = product;
    squares[lane] = square;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) {
            products[lane] += products[lane + half_size];
            squares[lane] += squares[lane + half_size];
        }
        barrier();
    }
    if (lane == 0u) {
        coefficients[b] = vec4(scale * (products[0] + weight(b, MEASUREMENTS) * sqrt(squares[0])), 0.0);
    }
}
