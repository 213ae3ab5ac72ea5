// Numbers, and dual numbers (gradient in xyz, value in w), under one set of names: code that prt_bench/implicit writes once
// gives a distance from numbers and its gradient from dual numbers. +, − and products with constants are GLSL's own.

const float TINY = 1e-20;  // as prt_bench/implicit/expression.py has it

float value(float a) { return a; }
float value(vec4 a) { return a.w; }

float constant(float like, float c) { return c; }
vec4 constant(vec4 like, float c) { return vec4(0.0, 0.0, 0.0, c); }

float plus(float a, float c) { return a + c; }
vec4 plus(vec4 a, float c) { return vec4(a.xyz, a.w + c); }

float times(float a, float b) { return a * b; }
vec4 times(vec4 a, vec4 b) { return vec4(a.xyz * b.w + b.xyz * a.w, a.w * b.w); }

float over(float a, float b) { return a / b; }
vec4 over(vec4 a, vec4 b) {
    float q = a.w / b.w;
    return vec4((a.xyz - q * b.xyz) / b.w, q);
}

float at_least_tiny(float a) { return max(a, TINY); }
vec4 at_least_tiny(vec4 a) { return a.w > TINY ? a : vec4(0.0, 0.0, 0.0, TINY); }

float root(float a) { return sqrt(max(a, TINY)); }
vec4 root(vec4 a) {
    float r = sqrt(max(a.w, TINY));
    return vec4(a.w > TINY ? a.xyz * (0.5 / r) : vec3(0.0), r);
}

float size(float a) { return abs(a); }
vec4 size(vec4 a) { return a.w < 0.0 ? -a : a; }

float least(float a, float b) { return min(a, b); }
vec4 least(vec4 a, vec4 b) { return a.w < b.w ? a : b; }

float most(float a, float b) { return max(a, b); }
vec4 most(vec4 a, vec4 b) { return a.w > b.w ? a : b; }

float sine(float a) { return sin(a); }
vec4 sine(vec4 a) { return vec4(cos(a.w) * a.xyz, sin(a.w)); }

float cosine(float a) { return cos(a); }
vec4 cosine(vec4 a) { return vec4(-sin(a.w) * a.xyz, cos(a.w)); }

float logarithm(float a) { return log(a); }
vec4 logarithm(vec4 a) { return vec4(a.xyz / a.w, log(a.w)); }

// Trilinear interpolation of a table of side³ numbers from `start` on, at node coordinates that are clamped to the table.
layout(std430, binding = 14) readonly buffer Tables { float tables[]; };

float entry(int start, int side, ivec3 cell) { return tables[start + cell.x + side * (cell.y + side * cell.z)]; }

float clamped(float a, float top) { return clamp(a, 0.0, top); }
vec4 clamped(vec4 a, float top) { return a.w < 0.0 ? vec4(0.0) : (a.w > top ? vec4(0.0, 0.0, 0.0, top) : a); }

#define LOOK_UP(Number) \
Number looked_up(int start, int side, Number x, Number y, Number z) { \
    ivec3 cell = min(ivec3(value(x), value(y), value(z)), ivec3(side - 2)); \
    Number u = plus(x, -float(cell.x)), v = plus(y, -float(cell.y)), w = plus(z, -float(cell.z)); \
    Number sum = constant(x, 0.0); \
    for (int corner = 0; corner < 8; ++corner) { \
        ivec3 up = ivec3(corner & 1, (corner >> 1) & 1, corner >> 2); \
        Number a = up.x == 1 ? u : plus(-u, 1.0), b = up.y == 1 ? v : plus(-v, 1.0), c = up.z == 1 ? w : plus(-w, 1.0); \
        sum += entry(start, side, cell + up) * times(a, times(b, c)); \
    } \
    return sum; \
}
LOOK_UP(float)
LOOK_UP(vec4)
