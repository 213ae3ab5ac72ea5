// M_ik = Σ_j Γ_ijk L_j of each channel, one invocation for each pair (i, k): what FIXED multiplies with in every pixel.
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 4) readonly buffer Entries { vec2 entries[]; };  // j, Γ
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 6) readonly buffer Starts { int starts[]; };
layout(std430, binding = 9) writeonly buffer Matrix { vec4 matrix[]; };

void main() {
    uint row = gl_GlobalInvocationID.x;
    if (row >= PAIRS) return;
    vec3 sum = vec3(0.0);
    for (int at = starts[row]; at < starts[row + 1]; ++at) sum += entries[at].y * coefficients[int(entries[at].x)].rgb;
    matrix[row] = vec4(sum, 0.0);
}
