// Radiance of a diffuse body that moves through a scene: albedo / π times DIRECT irradiance and, where there are PROBES, theirs.
#ifdef DIRECT
#include "emitters.glsl"
#endif
#ifdef PROBES
#include "probes.glsl"
#endif

in vec3 position;
flat in vec3 normal;

uniform vec3 albedo;

out vec4 radiance;

void main() {
    vec3 irradiance = vec3(0.0);
#ifdef DIRECT
    irradiance += direct_irradiance(position, normal);
#endif
#ifdef PROBES
    irradiance += probe_irradiance(position, normal);
#endif
    radiance = vec4(albedo / 3.14159265358979 * irradiance, 1.0);
}
