// Coefficients of the direct light of each cluster on its own functions: one workgroup for each function, which only the samples
// of its cluster have values of.
#include "samples.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 4) readonly buffer Sources { uint sources[]; };  // [SAMPLES, SOURCE_PAIRS]
layout(std430, binding = 5) readonly buffer Starts { int starts[]; };  // first sample of each cluster, and the end
layout(std430, binding = 6) writeonly buffer Measured { vec4 measured[]; };  // [clusters · SOURCES]

shared vec3 partial[WORKGROUP];

void main() {
    int lane = int(gl_LocalInvocationID.x), row = int(gl_WorkGroupID.x);
    int cluster = row / SOURCES, q = row % SOURCES;
    vec3 sum = vec3(0.0);
    for (int at = starts[cluster] + lane; at < starts[cluster + 1]; at += WORKGROUP) {
        sum += unpackSnorm2x16(sources[at * SOURCE_PAIRS + q / 2])[q % 2] * lights[at].direct.rgb;
    }
    partial[lane] = sum;
    barrier();
    for (int half_size = WORKGROUP / 2; half_size > 0; half_size /= 2) {
        if (lane < half_size) partial[lane] += partial[lane + half_size];
        barrier();
    }
    if (lane == 0) measured[row] = vec4(partial[0], 0.0);
}
