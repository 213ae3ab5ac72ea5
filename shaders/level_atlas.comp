// The padded image of a level's light: every texel shows one sample, those of a border a sample of the next face.
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 6) readonly buffer Sources { int sources[]; };  // −1 where no tile is
layout(std430, binding = 8) readonly buffer Light { vec4 light[]; };
layout(rgba32f, binding = 0) writeonly uniform image2DArray atlas;

void main() {
    int texel = int(gl_GlobalInvocationID.x);
    if (texel >= RESOLUTION * RESOLUTION) return;
    vec4 shown = sources[texel] < 0 ? vec4(0.0) : light[sources[texel]];
    imageStore(atlas, ivec3(texel % RESOLUTION, texel / RESOLUTION, 0), shown);
}
