// Shadow lookup in the depth atlas.
//
// A plane stays a plane under projection, so the depth of the receiver's plane is known exactly at every shadow texel:
// each of the four texels around a point is compared with the plane's depth there, and no slope-dependent bias is needed.
// - Where the plane runs deeper than the point itself, the point's depth is used, since another surface may begin in
//   between (a concave edge).
// - Where the texel's depth lies beyond the plane, the surface has ended (a silhouette) and the texel is left out.
// - Depths count as equal within a fraction of a texel along the ray, for curved surfaces, and the bake's ray offset.
#include "views.glsl"

layout(binding = 0) uniform sampler2D shadow_atlas;

// Faces of a cube in the order +x −x +y −y +z −z.
int cube_face(vec3 d) {
    vec3 a = abs(d);
    if (a.x >= a.y && a.x >= a.z) return d.x > 0.0 ? 0 : 1;
    if (a.y >= a.z) return d.y > 0.0 ? 2 : 3;
    return d.z > 0.0 ? 4 : 5;
}

// Share of the light that arrives: bilinear weights of the four nearest depth comparisons.
float visibility(Emitter e, vec3 position, vec3 normal, float incidence) {
    int face = e.intensity.w > 1.0 ? cube_face(position - e.position.xyz) : 0;
    View view = views[int(e.axis.w) + face];

    vec4 clip = view.to_tile * vec4(position, 1.0);
    vec3 here = clip.xyz / clip.w * 0.5 + 0.5;

    // The plane (normal, −normal · position) in clip space: the depth on it changes by `slope` from texel to texel.
    vec3 plane = vec3(dot(normal, view.from_tile[0].xyz), dot(normal, view.from_tile[1].xyz),
                      dot(normal, view.from_tile[2].xyz - view.from_tile[2].w * position));
    vec2 slope = -plane.xy / (plane.z * tile_size);
    // Depth changes by `lift` per metre along the normal, so by incidence · lift along the ray.
    float lift = 0.5 / (abs(plane.z) * clip.w);
    float texel = view.tile.z * clip.w;
    here.z -= (DEPTH_OFFSET * texel + RAY_OFFSET) * incidence * lift;

    vec2 at = here.xy * tile_size - 0.5;
    vec2 base = clamp(floor(at), vec2(0.0), vec2(tile_size - 2.0));
    vec2 f = at - base;
    // Texels in textureGather's order: (0,1) (1,1) (1,0) (0,0).
    vec4 depth = textureGather(shadow_atlas, (view.tile.xy + base + 1.0) / ATLAS_SIZE);
    vec4 beyond = vec4(dot(slope, vec2(0, 1) - f), dot(slope, vec2(1, 1) - f),
                       dot(slope, vec2(1, 0) - f), dot(slope, vec2(0, 0) - f));
    vec4 lit = step(here.z + min(beyond, 0.0), depth);
    vec4 present = step(depth, here.z + beyond + SURFACE_END * texel * lift);

    f = clamp(f, 0.0, 1.0);
    vec4 weight = present * vec4((1.0 - f.x) * f.y, f.x * f.y, f.x * (1.0 - f.y), (1.0 - f.x) * (1.0 - f.y));
    float total = weight.x + weight.y + weight.z + weight.w;
    return total > 0.0 ? dot(weight, lit) / total : 1.0;
}
