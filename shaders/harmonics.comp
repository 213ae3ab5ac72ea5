// Coefficients of distant light, Σ_q E_q y_k(ω_q), as prt_bench/harmonic.py has them: one invocation per coefficient.
// Emitters that are not distant count as far away as they look from CENTRE.
#include "emitters.glsl"
#include "harmonics.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 5) writeonly buffer Coefficients { vec4 coefficients[]; };

void main() {
    int k = int(gl_GlobalInvocationID.x);
    if (k >= COEFFICIENTS) return;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < emitter_count && k < HARMONICS; ++i) {
        Emitter e = emitters[i];
        vec3 offset = e.position.xyz - CENTRE * e.position.w;
        float distance_squared = dot(offset, offset);
        vec3 direction = offset * inversesqrt(max(distance_squared, 1e-24));
        sum += attenuation(e, direction, distance_squared) * harmonic(k, direction) * e.intensity.rgb;
    }
    coefficients[k] = vec4(sum, 0.0);
}
