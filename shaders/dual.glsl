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

// Quadratic B-spline with side³ coefficients from `start` on, at node coordinates that are clamped to the table.
layout(std430, binding = 14) readonly buffer Tables { float tables[]; };

float clamped(float a, float top) { return clamp(a, 0.0, top); }
vec4 clamped(vec4 a, float top) { return a.w < 0.0 ? vec4(0.0) : (a.w > top ? vec4(0.0, 0.0, 0.0, top) : a); }

#define LOOK_UP(Number) \
void spline(Number t, out Number weights[3]) { \
    Number below = plus(-t, 0.5), above = plus(t, 0.5); \
    weights = Number[](0.5 * times(below, below), plus(-times(t, t), 0.75), 0.5 * times(above, above)); \
} \
Number looked_up(int start, int side, Number x, Number y, Number z) { \
    ivec3 middle = ivec3(floor(vec3(value(x), value(y), value(z)) + 0.5)), top = ivec3(side - 1); \
    Number a[3], b[3], c[3]; \
    spline(plus(x, -float(middle.x)), a); \
    spline(plus(y, -float(middle.y)), b); \
    spline(plus(z, -float(middle.z)), c); \
    Number sum = constant(x, 0.0); \
    for (int k = 0; k < 3; ++k) { \
        Number layer = constant(x, 0.0); \
        for (int j = 0; j < 3; ++j) { \
            Number row = constant(x, 0.0); \
            for (int i = 0; i < 3; ++i) { \
                ivec3 node = clamp(middle + ivec3(i, j, k) - 1, ivec3(0), top); \
                row += tables[start + node.x + side * (node.y + side * node.z)] * a[i]; \
            } \
            layer += times(row, b[j]); \
        } \
        sum += times(layer, c[k]); \
    } \
    return sum; \
}
LOOK_UP(float)
LOOK_UP(vec4)
