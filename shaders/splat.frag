// A sample's light times a Gaussian of the distance between the sample and the surface that the pixel shows, and that weight. What
// faces another way, lies off the sample's surface or behind a wall on it gets nothing.
flat in vec3 centre;
flat in mat3 frame;
flat in float reach;
flat in vec4 walls;
flat in vec4 further_walls;
flat in vec3 light;
flat in vec3 share;

layout(binding = 11) uniform sampler2D places;
layout(binding = 12) uniform sampler2D normals;

layout(location = 0) out vec4 light_sum;
layout(location = 1) out vec4 shadow_sum;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 place = texelFetch(places, at, 0);
    vec3 offset = (place.xyz - centre) * frame;
    float behind = max(max(dot(offset.xy, walls.xy), dot(offset.xy, walls.zw)),
                       max(dot(offset.xy, further_walls.xy), dot(offset.xy, further_walls.zw)));
    float spread = dot(offset, offset) / (reach * reach);
    if (place.w == 0.0 || spread > 1.0 || abs(offset.z) > OFF_SURFACE * reach || behind > 1.001) discard;
    if (dot(texelFetch(normals, at, 0).xyz, frame[2]) < SAME_WAY) discard;
    float weight = exp(-SHARPNESS * spread);
    light_sum = vec4(light, 1.0) * weight;
    shadow_sum = vec4(share, 1.0) * weight;
}
