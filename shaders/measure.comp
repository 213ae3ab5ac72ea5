// Direct irradiance at the measurement points: one invocation per dense point, averaged over each group of SUPERSAMPLES.
#include "emitters.glsl"

layout(local_size_x = SUPERSAMPLES, local_size_y = POINTS_PER_WORKGROUP) in;

struct DensePoint {
    vec4 position;
    vec4 normal;
};

layout(std430, binding = 2) readonly buffer DensePoints { DensePoint points[]; };
layout(std430, binding = 3) writeonly buffer Measured { vec4 measured[]; };

shared vec3 partial[POINTS_PER_WORKGROUP][SUPERSAMPLES];

void main() {
    uint sample_index = gl_LocalInvocationID.x;
    uint row = gl_LocalInvocationID.y;
    uint m = gl_GlobalInvocationID.y;
    if (m < MEASUREMENTS) {
        DensePoint point = points[m * SUPERSAMPLES + sample_index];
        partial[row][sample_index] = direct_irradiance(point.position.xyz, point.normal.xyz);
    }
    barrier();
    if (m < MEASUREMENTS && sample_index == 0u) {
        vec3 sum = vec3(0.0);
        for (int k = 0; k < SUPERSAMPLES; ++k) sum += partial[row][k];
        measured[m] = vec4(sum / float(SUPERSAMPLES), 0.0);
    }
}
