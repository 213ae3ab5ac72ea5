// What evaluates a network anywhere: its weights by blocks of four inputs, and the rectifier. HALF stores them in float16.

#ifdef HALF
layout(std430, binding = 10) readonly buffer Matrices { uvec2 matrices[]; };

vec4 four(uint block) { return vec4(unpackHalf2x16(matrices[block].x), unpackHalf2x16(matrices[block].y)); }
#else
layout(std430, binding = 10) readonly buffer Matrices { vec4 matrices[]; };

vec4 four(uint block) { return matrices[block]; }
#endif

vec3 squareplus(vec3 v) { return 0.5 * (v + sqrt(v * v + 1.0)); }

vec4 squareplus(vec4 v) { return 0.5 * (v + sqrt(v * v + 1.0)); }
