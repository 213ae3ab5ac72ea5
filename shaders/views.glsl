// Shadow views: a square tile of the depth atlas for each direction, cone, or face of a cube.

struct View {
    mat4 to_tile;    // world to the tile's clip space
    mat4 from_tile;  // its inverse
    vec4 tile;       // corner in texels of the atlas, world size of a texel per unit of clip w
};

layout(std430, binding = 1) readonly buffer Views {
    float tile_size;  // side of every tile in texels
    View views[];
};
