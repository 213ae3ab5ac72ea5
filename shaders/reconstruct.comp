// Indirect irradiance at the receivers, for comparison with the model: the draw pass's reconstruction at texel centres.
#include "reconstruct.glsl"

layout(local_size_x = 64) in;

layout(std430, binding = 6) readonly buffer Texels { int texels[]; };
layout(std430, binding = 7) writeonly buffer Values { vec4 values[]; };
#ifdef RECONSTRUCT_FIELD
layout(std430, binding = 13) readonly buffer Places { vec4 places[]; };  // position and normal of each receiver
#endif

void main() {
    uint t = gl_GlobalInvocationID.x;
    if (t >= RECEIVERS) return;
#ifdef RECONSTRUCT_FIELD
    place_on_surface = Place(places[2 * t].xyz, places[2 * t + 1].xyz);
#endif
    vec2 uv = (vec2(texels[t] % RESOLUTION, texels[t] / RESOLUTION) + 0.5) / float(RESOLUTION);
    values[t] = vec4(indirect_irradiance(uv), 0.0);
}
