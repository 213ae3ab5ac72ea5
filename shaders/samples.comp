// Direct irradiance at the samples, with shadows from compressed depth and without any: one invocation for each.
#include "emitters.glsl"
#include "samples.glsl"
#include "depth.glsl"

layout(local_size_x = 64) in;

void main() {
    int at = int(gl_GlobalInvocationID.x);
    if (at >= SAMPLES) return;
    vec3 position = samples[at].position.xyz, normal = samples[at].normal.xyz, tangent = samples[at].tangent.xyz;
    look_from(at, int(samples[at].position.w), mat3(tangent, cross(normal, tangent), normal));
    vec3 direct = vec3(0.0), open = vec3(0.0);
    for (int i = 0; i < emitter_count; ++i) {
        Emitter e = emitters[i];
        float incidence;
        vec3 light = strength(e, position, normal, incidence) * e.intensity.rgb;
        if (light != vec3(0.0)) {
            open += light;
            direct += visibility(e, position) * light;
        }
    }
    lights[at].direct = vec4(direct, 0.0);
    lights[at].open = vec4(open, 0.0);
}
