// Shades what implicit.frag met: one invocation per pixel, and a workgroup fetches the network's weights together. Workgroups
// that met nothing do nothing, and leave the sky.
#include "surface.glsl"

layout(local_size_x = TILE_SIDE, local_size_y = TILE_SIDE) in;

layout(binding = 5) uniform sampler2D hit_position;
layout(binding = 6) uniform sampler2D hit_normal;
layout(binding = 0, rgba32f) writeonly uniform image2D radiance;

shared uint met;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size_of = textureSize(hit_position, 0);
    bool on_screen = all(lessThan(pixel, size_of));
    vec4 position = on_screen ? texelFetch(hit_position, pixel, 0) : vec4(0.0);
    vec3 normal = on_screen ? texelFetch(hit_normal, pixel, 0).xyz : vec3(0.0, 1.0, 0.0);
    int part = int(position.w) - 1;
    if (gl_LocalInvocationIndex == 0u) met = 0u;
    barrier();
    if (part >= 0) atomicOr(met, 1u);
    barrier();
    if (met == 0u) return;
    vec4 rows[ROWS * LAYERS];
    transfer_vectors(Place(position.xyz, normal), rows);
    if (part >= 0) imageStore(radiance, pixel, vec4(radiance_of(position.xyz, normal, part, rows), 1.0));
}
