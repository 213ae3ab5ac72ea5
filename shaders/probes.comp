// Coefficients of probes from what an asset predicts for the directions that each of them faces: those are the receivers, J of a
// probe in turn, at texels of a square image.
#include "reconstruct.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 6) readonly buffer Projection { float projection[]; };  // [9, FACINGS]
layout(std430, binding = 9) buffer Probes { vec4 probes[]; };

void main() {
    int p = int(gl_GlobalInvocationID.x);
    if (p >= PROBES) return;
    vec3 sum[9];
    for (int k = 0; k < 9; ++k) sum[k] = vec3(0.0);
    for (int j = 0; j < FACINGS; ++j) {
        int t = p * FACINGS + j;
        vec3 received = indirect_irradiance((vec2(t % RESOLUTION, t / RESOLUTION) + 0.5) / float(RESOLUTION));
        for (int k = 0; k < 9; ++k) sum[k] += projection[k * FACINGS + j] * received;
    }
    for (int k = 0; k < 9; ++k) probes[9 * p + k].rgb = sum[k];
}
