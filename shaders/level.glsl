// Blocks of a level, and the order of their samples in each pose.
struct Block {
    ivec4 kind;    // entry of the dictionary, pose, bits of the faces that are there, the pose that undoes it
    int doors[8];  // the interface that light in each of six poses enters by (in a cube, towards its faces), −1 for none
};

layout(std430, binding = 6) readonly buffer Blocks { Block blocks[]; };
layout(std430, binding = 7) readonly buffer Turns { int turns[]; };  // [pose, sample]

const int DOORS = 6;

uint turned(int pose, uint s) { return uint(turns[uint(pose) * SAMPLES + s]); }
