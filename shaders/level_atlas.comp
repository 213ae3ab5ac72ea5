// The padded image of a level's light: every texel shows one sample, those of a border a sample of the next face. With TILTED three
// layers more: how that light changes with the normal, along each axis.
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 6) readonly buffer Sources { int sources[]; };  // −1 where no tile is
layout(std430, binding = 8) readonly buffer Light { vec4 light[]; };
#ifdef TILTED
layout(std430, binding = 9) readonly buffer Slopes { vec4 slopes[]; };  // [sample, axis]
#endif
layout(rgba32f, binding = 0) writeonly uniform image2DArray atlas;

void main() {
    int texel = int(gl_GlobalInvocationID.x);
    if (texel >= RESOLUTION * RESOLUTION) return;
    ivec2 place = ivec2(texel % RESOLUTION, texel / RESOLUTION);
    int source = sources[texel];
    imageStore(atlas, ivec3(place, 0), source < 0 ? vec4(0.0) : light[source]);
#ifdef TILTED
    for (int axis = 0; axis < 3; ++axis) {
        imageStore(atlas, ivec3(place, 1 + axis), source < 0 ? vec4(0.0) : slopes[3 * source + axis]);
    }
#endif
}
