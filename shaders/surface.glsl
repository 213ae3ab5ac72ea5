// Radiance of an implicit surface from the transfer vectors of a network: albedo / π times irradiance, and the lobe of a glossy
// material from the last row, which is that of direct light. Light and materials are read from buffers, so both may change.
#include "reconstruct.glsl"
#ifdef GLOSSY
#include "glossy.glsl"
#endif

struct Reflectance { vec4 albedo; vec4 specular; };  // specular.w: the exponent
layout(std430, binding = 15) readonly buffer Reflectances { Reflectance reflectances[]; };

uniform vec3 eye;

vec3 radiance_of(vec3 position, vec3 normal, int part, vec4 rows[ROWS * LAYERS]) {
    const float pi = 3.14159265358979;
    Reflectance here = reflectances[part];
    vec3 sum = here.albedo.rgb / pi * irradiance_of(rows);
#ifdef GLOSSY
    if (here.specular.rgb != vec3(0.0)) {
        float lobe_at[HARMONICS], visible[HARMONICS];
        harmonics(reflect(normalize(position - eye), normal), lobe_at);
        lobe(here.specular.w, lobe_at);
        for (int k = 0; k < HARMONICS; ++k) visible[k] = rows[(ROWS - 1) * LAYERS + k / 4][k % 4];
        sum += here.specular.rgb * max(gloss_of(visible, lobe_at), vec3(0.0));
    }
#endif
    return sum;
}
