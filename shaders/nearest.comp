// The stored direction closest to the measured vector, per channel: coefficients[0] is ‖x‖, coefficients[1] the choice.
// One workgroup; the first of equal scores wins.

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Measured { vec4 measured[]; };
layout(std430, binding = 4) readonly buffer Directions { float directions[]; };  // [BASIS, MEASUREMENTS]
layout(std430, binding = 5) writeonly buffer Coefficients { vec4 coefficients[]; };

shared vec3 scores[WORKGROUP];
shared vec3 choices[WORKGROUP];

void main() {
    uint lane = gl_LocalInvocationID.x;

    vec3 largest = vec3(0.0);
    for (uint m = 0; m < MEASUREMENTS; ++m) largest = max(largest, abs(measured[m].rgb));
    vec3 scale = mix(largest, vec3(1.0), equal(largest, vec3(0.0)));

    vec3 best = vec3(-1e30), choice = vec3(0.0);
    for (uint b = lane; b < BASIS; b += WORKGROUP) {
        vec3 score = vec3(0.0);
        for (uint m = 0; m < MEASUREMENTS; ++m) score += directions[b * MEASUREMENTS + m] * (measured[m].rgb / scale);
        bvec3 better = greaterThan(score, best);
        best = mix(best, score, better);
        choice = mix(choice, vec3(b), better);
    }
    scores[lane] = best;
    choices[lane] = choice;
    barrier();
    for (uint half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) {
            vec3 score = scores[lane + half_size], other = choices[lane + half_size];
            for (int c = 0; c < 3; ++c) {
                if (score[c] > scores[lane][c] || (score[c] == scores[lane][c] && other[c] < choices[lane][c])) {
                    scores[lane][c] = score[c];
                    choices[lane][c] = other[c];
                }
            }
        }
        barrier();
    }
    if (lane == 0u) {
        vec3 square = vec3(0.0);
        for (uint m = 0; m < MEASUREMENTS; ++m) {
            vec3 x = measured[m].rgb / scale;
            square += x * x;
        }
        coefficients[0] = vec4(scale * sqrt(square), 0.0);
        coefficients[1] = vec4(choices[0], 0.0);
    }
}
