// Depth of the scene as every emitter sees it: one instance per view, mapped into its tile and clipped to it.
#include "views.glsl"

in vec3 in_position;

out gl_PerVertex {
    vec4 gl_Position;
    float gl_ClipDistance[4];
};

void main() {
    View view = views[gl_InstanceID];
    vec4 clip = view.to_tile * vec4(in_position, 1.0);
    gl_ClipDistance[0] = clip.w + clip.x;
    gl_ClipDistance[1] = clip.w - clip.x;
    gl_ClipDistance[2] = clip.w + clip.y;
    gl_ClipDistance[3] = clip.w - clip.y;
    vec2 centre = (view.tile.xy + 0.5 * tile_size) / ATLAS_SIZE * 2.0 - 1.0;
    gl_Position = vec4(clip.xy * (tile_size / ATLAS_SIZE) + centre * clip.w, clip.zw);
}
