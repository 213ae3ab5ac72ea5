// Samples of surfaces without a lightmap, and the light at them in W/m².
struct Sample {
    vec4 position;  // w: its cluster
    vec4 normal;    // w: how far its light is spread, in m
    vec4 tangent;
    vec4 walls[2];  // four lines on its surface: places x along tangent and bitangent lie behind one where x · walls > 1
};

struct SampleLight {
    vec4 direct;
    vec4 open;  // direct light if nothing cast shadows
    vec4 indirect;
};

layout(std430, binding = 2) readonly buffer Samples { Sample samples[]; };
layout(std430, binding = 9) buffer SampleLights { SampleLight lights[]; };
