// Indirect irradiance at the samples of every block: U_b b of its own light, and U_r r of what enters by each of its interfaces.
// One invocation a sample.
#include "level.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Basis { float basis[]; };        // [kind, coefficient, sample]
layout(std430, binding = 4) readonly buffer Arriving { float arriving[]; };  // [coefficient, sample]
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 8) writeonly buffer Light { vec4 light[]; };
layout(std430, binding = 9) readonly buffer Entered { vec4 entered[]; };

void main() {
    uint s = gl_GlobalInvocationID.x;
    uint at = gl_WorkGroupID.y;
    if (s >= SAMPLES) return;
    Block block = blocks[at];
    vec3 sum = vec3(0.0);
    if ((block.kind.z >> (s / (SAMPLES / uint(FACES))) & 1) != 0) {
        uint column = uint(block.kind.x) * BASIS * SAMPLES + turned(block.kind.y, s);
        for (uint k = 0u; k < BASIS; ++k) sum += basis[column + k * SAMPLES] * coefficients[at * BASIS + k].rgb;
        for (int pose = 0; pose < DOORS; ++pose) {
            if (block.doors[pose] < 0) continue;
            uint source = uint(block.doors[pose]) * ARRIVING;
            column = turned(pose, s);  // what enters stands as its light goes
            for (uint k = 0u; k < ARRIVING; ++k) sum += arriving[column + k * SAMPLES] * entered[source + k].rgb;
        }
    }
    light[at * SAMPLES + s] = vec4(sum, 0.0);
}
