// Radiance of diffuse surfaces: albedo / π · (direct + indirect irradiance). DIRECT, INDIRECT, SHADOWS and ALBEDO_IMAGE
// compile their part in.
#ifdef DIRECT
#include "emitters.glsl"
#endif
#ifdef INDIRECT
#include "reconstruct.glsl"
#endif

in vec3 position;
in vec2 lightmap_uv;
in vec2 image_uv;
flat in vec3 normal;
flat in vec3 albedo;

out vec4 radiance;

#ifdef ALBEDO_IMAGE
layout(binding = 2) uniform sampler2D albedo_image;
#endif

const float PI = 3.14159265358979;

void main() {
    vec3 irradiance = vec3(0.0);
#ifdef DIRECT
    irradiance += direct_irradiance(position, normal);
#endif
#ifdef INDIRECT
    irradiance += indirect_irradiance(lightmap_uv);
#endif
    vec3 reflectance = albedo;
#ifdef ALBEDO_IMAGE
    reflectance *= texture(albedo_image, image_uv).rgb;
#endif
    radiance = vec4(reflectance / PI * irradiance, 1.0);
}
