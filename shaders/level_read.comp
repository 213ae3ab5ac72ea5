// b of every block: READ of its kind times the radiosity of its samples, in the order that the kind has them. One workgroup a
// block: it keeps the radiosity of some samples at a time, of which each slice of lanes takes its share, a lane a coefficient.
#include "level.glsl"

layout(local_size_x = BASIS, local_size_y = SLICES) in;

layout(std430, binding = 3) readonly buffer Measured { vec4 measured[]; };
layout(std430, binding = 4) readonly buffer Read { float read[]; };  // [kind, sample, coefficient]
layout(std430, binding = 5) writeonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 8) readonly buffer Light { vec4 light[]; };
layout(std430, binding = 9) readonly buffer Albedo { vec4 albedo[]; };

const uint LANES = BASIS * SLICES;

shared vec3 radiosity[LANES];

void main() {
    uint lane = gl_LocalInvocationIndex;
    uint at = gl_LocalInvocationID.x;
    uint slice = gl_LocalInvocationID.y;
    Block block = blocks[gl_WorkGroupID.x];
    vec3 sum = vec3(0.0);
    for (uint first = 0u; first < SAMPLES; first += LANES) {
        if (first + lane < SAMPLES) {
            uint here = gl_WorkGroupID.x * SAMPLES + turned(block.kind.w, first + lane);
            radiosity[lane] = albedo[here].rgb * (measured[here].rgb + light[here].rgb);
        }
        barrier();
        uint count = min(LANES, SAMPLES - first);
        uint row = (uint(block.kind.x) * SAMPLES + first) * BASIS + at;
        for (uint s = slice; s < count; s += SLICES) sum += read[row + s * BASIS] * radiosity[s];
        barrier();
    }
    radiosity[lane] = sum;
    barrier();
    if (slice == 0u) {
        for (uint other = 1u; other < SLICES; ++other) sum += radiosity[other * BASIS + at];
        coefficients[gl_WorkGroupID.x * BASIS + at] = vec4(sum, 0.0);
    }
}
