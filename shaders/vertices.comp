// Light at the vertices: transfer vector · coefficients of each channel, one invocation per vertex.
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 4) readonly buffer Transfer { float transfer[]; };  // [VERTICES, TRANSFER_CHANNELS, HARMONICS]
layout(std430, binding = 5) readonly buffer Coefficients { vec4 coefficients[]; };
layout(std430, binding = 8) writeonly buffer Light { vec4 light[]; };

void main() {
    uint v = gl_GlobalInvocationID.x;
    if (v >= VERTICES) return;
    vec3 sum = vec3(0.0);
    uint at = v * TRANSFER_CHANNELS * HARMONICS;
    for (uint k = 0; k < HARMONICS; ++k, ++at) {
#if TRANSFER_CHANNELS == 1
        vec3 t = vec3(transfer[at]);
#else
        vec3 t = vec3(transfer[at], transfer[at + HARMONICS], transfer[at + 2 * HARMONICS]);
#endif
        sum += t * coefficients[k].rgb;
    }
    light[v] = vec4(sum, 0.0);
}
