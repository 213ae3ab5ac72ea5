// Blocks of a level, and the order of their samples after each rotation.
struct Block {
    ivec4 kind;    // entry of the dictionary, rotation, bits of the faces that are there, inverse of the rotation
    int doors[8];  // the interface that light towards each of the six faces enters by, −1 for none
};

layout(std430, binding = 6) readonly buffer Blocks { Block blocks[]; };
layout(std430, binding = 7) readonly buffer Turns { int turns[]; };  // [rotation, sample]

const int FACES = 6;

uint turned(int rotation, uint s) { return uint(turns[uint(rotation) * SAMPLES + s]); }
