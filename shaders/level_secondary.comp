// NUMBERS at SAMPLES places of every block, from its own b and from what enters by each of its interfaces, turned as these stand:
// vectors that say how light on a face changes with the normal, or, of PROBES, harmonics of irradiance in the air, which go to
// the level's volume. One invocation a place.
#include "level.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) readonly buffer Own { float own[]; };            // [kind, coefficient, place, number]
layout(std430, binding = 4) readonly buffer Arriving { float arriving[]; };  // [coefficient, place, number]
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 8) buffer Found { vec4 found[]; };
layout(std430, binding = 9) readonly buffer Entered { vec4 entered[]; };
layout(std430, binding = 10) readonly buffer Rotations { float rotations[]; };  // [rotation, number, number]
#ifdef PROBES
layout(std430, binding = 11) readonly buffer Numbers { int numbers[]; };  // [block, place]: its probe in the volume
#endif

vec3 sums[NUMBERS];

void add(int rotation, vec3 numbers[NUMBERS]) {
    uint row = uint(rotation) * NUMBERS * NUMBERS;
    for (uint i = 0u; i < NUMBERS; ++i) {
        for (uint j = 0u; j < NUMBERS; ++j) sums[i] += rotations[row + i * NUMBERS + j] * numbers[j];
    }
}

void main() {
    uint s = gl_GlobalInvocationID.x;
    uint at = gl_WorkGroupID.y;
    if (s >= SAMPLES) return;
    Block block = blocks[at];
    for (uint i = 0u; i < NUMBERS; ++i) sums[i] = vec3(0.0);
#ifndef PROBES
    if ((block.kind.z >> (s / (SAMPLES / 6u)) & 1) != 0)
#endif
    {
        vec3 parts[NUMBERS];
        for (uint j = 0u; j < NUMBERS; ++j) parts[j] = vec3(0.0);
        uint place = NUMBERS * turned(block.kind.y, s);
        uint row = uint(block.kind.x) * BASIS * SAMPLES * NUMBERS + place;
        for (uint k = 0u; k < BASIS; ++k) {
            vec3 b = coefficients[at * BASIS + k].rgb;
            for (uint j = 0u; j < NUMBERS; ++j) parts[j] += own[row + k * SAMPLES * NUMBERS + j] * b;
        }
        add(block.kind.y, parts);
        for (int pose = 0; pose < DOORS; ++pose) {
            if (block.doors[pose] < 0) continue;
            for (uint j = 0u; j < NUMBERS; ++j) parts[j] = vec3(0.0);
            row = NUMBERS * turned(pose, s);
            for (uint k = 0u; k < ARRIVING; ++k) {
                vec3 r = entered[uint(block.doors[pose]) * ARRIVING + k].rgb;
                for (uint j = 0u; j < NUMBERS; ++j) parts[j] += arriving[row + k * SAMPLES * NUMBERS + j] * r;
            }
            add(pose, parts);
        }
    }
#ifdef PROBES
    uint first = NUMBERS * uint(numbers[at * SAMPLES + s]);
    for (uint i = 0u; i < NUMBERS; ++i) found[first + i].rgb = sums[i];
#else
    uint first = NUMBERS * (at * SAMPLES + s);
    for (uint i = 0u; i < NUMBERS; ++i) found[first + i] = vec4(sums[i], 0.0);
#endif
}
