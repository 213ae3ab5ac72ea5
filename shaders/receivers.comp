// Indirect irradiance at the samples: the functions of each one's cluster times what linear.comp found for them.
#include "samples.glsl"

layout(local_size_x = 64) in;

layout(std430, binding = 4) readonly buffer Receivers { uint receivers[]; };  // [SAMPLES, RECEIVER_PAIRS]
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };  // [clusters · RECEIVERS]

void main() {
    int at = int(gl_GlobalInvocationID.x);
    if (at >= SAMPLES) return;
    int first = int(samples[at].position.w) * RECEIVERS;
    vec3 sum = vec3(0.0);
    for (int b = 0; b < RECEIVERS; ++b) {
        sum += unpackSnorm2x16(receivers[at * RECEIVER_PAIRS + b / 2])[b % 2] * coefficients[first + b].rgb;
    }
    lights[at].indirect = vec4(sum, 0.0);
}
