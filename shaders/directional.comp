// Coefficients of directional light at every texel from what an asset predicts for its receivers, nine of a point in turn at
// texels of a square image of side SIDE.
#include "reconstruct.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 6) readonly buffer Sources { int sources[]; };  // the point whose light a texel shows
layout(binding = 0, rgba32f) writeonly uniform image2DArray arriving;

void main() {
    int texel = int(gl_GlobalInvocationID.x);
    if (texel >= RESOLUTION * RESOLUTION) return;
    for (int k = 0; k < 9; ++k) {
        int t = 9 * sources[texel] + k;
        vec3 light = indirect_irradiance((vec2(t % SIDE, t / SIDE) + 0.5) / float(SIDE));
        imageStore(arriving, ivec3(texel % RESOLUTION, texel / RESOLUTION, k), vec4(light, 0.0));
    }
}
