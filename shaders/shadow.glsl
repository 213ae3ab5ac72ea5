// Shadow lookup in the depth atlas.
//
// A plane stays a plane under projection, so the depth of the receiver's plane is known exactly at every shadow texel:
// each of the four texels around a point is compared with the plane's depth there, not with the point's own. A small
// offset along the normal, in shadow texels, is left for what is not planar: curvature and concave edges.
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
float visibility(Emitter e, vec3 position, vec3 normal) {
    int face = e.intensity.w > 1.0 ? cube_face(position - e.position.xyz) : 0;
    View view = views[int(e.axis.w) + face];

    float texel = (view.to_tile * vec4(position, 1.0)).w * view.tile.z;
    vec3 lifted = position + normal * (RAY_OFFSET + NORMAL_OFFSET * texel);
    vec4 clip = view.to_tile * vec4(lifted, 1.0);
    vec3 here = clip.xyz / clip.w * 0.5 + 0.5;

    // The plane (normal, −normal · lifted) in clip space: its depth changes by `slope` per texel.
    vec3 plane = vec3(dot(normal, view.from_tile[0].xyz), dot(normal, view.from_tile[1].xyz),
                      dot(normal, view.from_tile[2].xyz - view.from_tile[2].w * lifted));
    vec2 slope = -plane.xy / (plane.z * tile_size);

    vec2 at = here.xy * tile_size - 0.5;
    vec2 base = clamp(floor(at), vec2(0.0), vec2(tile_size - 2.0));
    vec4 depth = textureGather(shadow_atlas, (view.tile.xy + base + 1.0) / ATLAS_SIZE);
    vec2 f = at - base;
    // textureGather's order: (0,1) (1,1) (1,0) (0,0)
    vec4 expected = here.z + vec4(dot(slope, vec2(0, 1) - f), dot(slope, vec2(1, 1) - f),
                                  dot(slope, vec2(1, 0) - f), dot(slope, vec2(0, 0) - f));
    vec4 lit = step(expected, depth);
    f = clamp(f, 0.0, 1.0);
    return mix(mix(lit.w, lit.z, f.x), mix(lit.x, lit.y, f.x), f.y);
}
