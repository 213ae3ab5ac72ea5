// r of every interface: the sum over the blocks whose light enters by it of a matrix times their b. One workgroup an interface:
// each slice of lanes takes its share of the blocks, a lane a coefficient.
layout(local_size_x = ARRIVING, local_size_y = SLICES) in;

layout(std430, binding = 4) readonly buffer Pairs { float pairs[]; };  // [pair, coefficient of b, coefficient of r]
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 6) readonly buffer From { int from[]; };
layout(std430, binding = 7) readonly buffer Starts { int starts[]; };
layout(std430, binding = 8) writeonly buffer Entered { vec4 entered[]; };

shared vec3 parts[SLICES][ARRIVING];

void main() {
    uint interface_ = gl_WorkGroupID.x;
    uint at = gl_LocalInvocationID.x;
    uint slice = gl_LocalInvocationID.y;
    vec3 sum = vec3(0.0);
    for (uint pair = uint(starts[interface_]) + slice; pair < uint(starts[interface_ + 1u]); pair += SLICES) {
        uint source = uint(from[pair]) * BASIS;
        uint row = pair * BASIS * ARRIVING + at;
        for (uint k = 0u; k < BASIS; ++k) sum += pairs[row + k * ARRIVING] * coefficients[source + k].rgb;
    }
    parts[slice][at] = sum;
    barrier();
    if (slice == 0u) {
        for (uint other = 1u; other < SLICES; ++other) sum += parts[other][at];
        entered[interface_ * ARRIVING + at] = vec4(sum, 0.0);
    }
}
