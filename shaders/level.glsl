// Blocks of a level, and the order of their samples after quarter turns.
struct Block {
    ivec4 kind;   // entry of the dictionary, quarter turns, bits of the faces that are there
    ivec4 doors;  // the interface that light along each of the four directions enters by, −1 for none
};

layout(std430, binding = 6) readonly buffer Blocks { Block blocks[]; };
layout(std430, binding = 7) readonly buffer Turns { int turns[]; };  // [quarter turns, sample]

const int SIDES = 4;

uint turned(int quarters, uint s) { return uint(turns[uint(quarters) * SAMPLES + s]); }
