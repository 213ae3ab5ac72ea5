// Glossy reflection at the receivers towards given mirror directions, for comparison with the model.
#include "reconstruct.glsl"
#include "glossy.glsl"

layout(local_size_x = 64) in;

layout(std430, binding = 6) readonly buffer Texels { int texels[]; };
layout(std430, binding = 7) buffer Values { vec4 values[]; };  // in: mirror direction and exponent, out: radiance

void main() {
    uint t = gl_GlobalInvocationID.x;
    if (t >= RECEIVERS) return;
    vec2 uv = (vec2(texels[t] % RESOLUTION, texels[t] / RESOLUTION) + 0.5) / float(RESOLUTION);
    values[t] = vec4(gloss(uv, values[t].xyz, values[t].w), 0.0);
}
