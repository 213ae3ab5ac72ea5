// Share of an emitter that a sample sees: the sample's compressed hemisphere of depth, reconstructed along the four directions
// that are nearest to the emitter's, against the emitter's distance. The same as ClusteredVisibility.lit. Values come as
// pairs in 16 bits; `look_from` prepares those of one sample.

layout(std430, binding = 4) readonly buffer DepthCoefficients { uint depth_coefficients[]; };  // [SAMPLES, DEPTH_PAIRS]
layout(std430, binding = 5) readonly buffer DepthBasis { uint depth_basis[]; };  // [clusters, DIRECTIONS, DEPTH_PAIRS]
// Of each cluster the mean of every direction, then what a product of coefficient and function is to be multiplied with.
layout(std430, binding = 6) readonly buffer DepthRows { float depth_rows[]; };  // [clusters, DIRECTIONS + 2 DEPTH_PAIRS]
layout(std430, binding = 7) readonly buffer Directions { vec4 directions[]; };  // [DIRECTIONS], in the frame of a sample
layout(std430, binding = 8) readonly buffer DirectionGrid { int grid[]; };  // starts [GRID_SIDE² + 1], then candidates

const int DEPTH_ROW = DIRECTIONS + 2 * DEPTH_PAIRS;

int cluster_here;
mat3 frame_here;  // columns tangent, bitangent, normal
vec2 coefficients_here[DEPTH_PAIRS];

void look_from(int at, int cluster, mat3 frame) {
    cluster_here = cluster;
    frame_here = frame;
    for (int k = 0; k < DEPTH_PAIRS; ++k) {
        int scale = cluster * DEPTH_ROW + DIRECTIONS + 2 * k;
        coefficients_here[k] = vec2(depth_rows[scale], depth_rows[scale + 1])
            * unpackSnorm2x16(depth_coefficients[at * DEPTH_PAIRS + k]);
    }
}

// The four nearest directions and how far away they are.
ivec4 nearest_directions(vec3 local, out vec4 gap) {
    vec2 place = local.xy * inversesqrt(1.0 + local.z);
    ivec2 cell = clamp(ivec2((0.5 * place + 0.5) * float(GRID_SIDE)), ivec2(0), ivec2(GRID_SIDE - 1));
    int at = cell.y * GRID_SIDE + cell.x;
    gap = vec4(8.0);
    ivec4 near = ivec4(0);
    for (int i = grid[at]; i < grid[at + 1]; ++i) {
        int j = grid[GRID_SIDE * GRID_SIDE + 1 + i];
        vec3 apart = local - directions[j].xyz;
        float d = dot(apart, apart);
        bvec4 nearer = lessThan(vec4(d), gap);
        if (nearer.x) { gap = vec4(d, gap.xyz); near = ivec4(j, near.xyz); }
        else if (nearer.y) { gap.yzw = vec3(d, gap.yz); near.yzw = ivec3(j, near.yz); }
        else if (nearer.z) { gap.zw = vec2(d, gap.z); near.zw = ivec2(j, near.z); }
        else if (nearer.w) { gap.w = d; near.w = j; }
    }
    gap = sqrt(gap);
    return near;
}

float visibility(Emitter e, vec3 position) {
    vec3 offset = e.position.xyz - position;
    float away = length(offset);
    vec4 gap;
    ivec4 near = nearest_directions((offset / away) * frame_here, gap);
    vec4 weight = 1.0 / (gap + 1e-6);
    float limit = 1.0 / ((1.0 - SLACK) * away + NEAR), seen = 0.0;
    for (int corner = 0; corner < 4; ++corner) {
        int first = (cluster_here * DIRECTIONS + near[corner]) * DEPTH_PAIRS;
        float stored = depth_rows[cluster_here * DEPTH_ROW + near[corner]];
        for (int k = 0; k < DEPTH_PAIRS; ++k) stored += dot(coefficients_here[k], unpackSnorm2x16(depth_basis[first + k]));
        if (stored <= limit) seen += weight[corner];
    }
    return seen / (weight.x + weight.y + weight.z + weight.w);
}
