// Radiance of surfaces: albedo / π · (direct + indirect irradiance), and GLOSSY the lobe that a material adds, of light stored as
// transfer or as coefficients of its own (DIRECTIONAL). DIRECT, INDIRECT,
// SHADOWS, GLOSSY and images of ALBEDO, ROUGHNESS and NORMAL compile their part in. Where bodies are TRANSLUCENT, indirect light
// is what leaves them over their colour, and that multiplies it. HAIR scatters direct light as fibres do. SPLATTED_SHADOWS come
// from samples, in place of shadow maps.
#ifdef DIRECT
#include "emitters.glsl"
#endif
#ifdef INDIRECT
#include "reconstruct.glsl"
#endif
#ifdef GLOSSY
#include "generated/harmonics"
#include "generated/lobe"
#ifdef DIRECTIONAL
#include "directional.glsl"
#else
#include "glossy.glsl"
#endif
#endif
#ifdef HAIR
#ifdef DIRECT
#include "hair.glsl"
#endif
#endif

in vec3 position;
in vec2 lightmap_uv;
in vec2 image_uv;
flat in vec3 normal;
#ifdef NORMAL_IMAGE
flat in vec3 tangent;
flat in vec3 bitangent;
layout(binding = 8) uniform sampler2D normal_image;
#endif
flat in vec3 albedo;
#ifdef TRANSLUCENT
flat in vec3 colour; // negative where the surface is opaque
#endif
#ifdef GLOSSY
flat in vec3 specular;
flat in float exponent;

uniform vec3 eye;
#ifdef ROUGHNESS_IMAGE
layout(binding = 7) uniform sampler2D roughness_image;
#endif
#endif

#ifdef HAIR
in vec3 fibre; // its tangent
flat in float clearance;
flat in int hair; // negative where the surface is no hair
#endif

out vec4 radiance;

#ifdef ALBEDO_IMAGE
layout(binding = 2) uniform sampler2D albedo_image;
#endif

const float PI = 3.14159265358979;

vec3 shading_normal() {
#ifdef NORMAL_IMAGE
    vec3 tilt = normalize(texture(normal_image, image_uv).xyz);
    tilt.z = max(tilt.z, LEAST_TILT);
    return normalize(mat3(tangent, bitangent, normal) * tilt);
#else
    return normal;
#endif
}

void main() {
#ifdef HAIR
    if (hair >= 0) {
        radiance = vec4(0.0, 0.0, 0.0, 1.0);
#ifdef INDIRECT
        radiance.rgb += albedo / PI * indirect_irradiance(lightmap_uv);
#endif
#ifdef DIRECT
        radiance.rgb += fibre_radiance(position, normalize(fibre), clearance, hair);
#endif
        return;
    }
#endif
    vec3 facing = shading_normal();
    vec3 irradiance = vec3(0.0);
#ifdef DIRECT
    irradiance += direct_irradiance(position, facing);
#ifdef SPLATTED_SHADOWS
    irradiance *= splatted_share();
#endif
#endif
#ifdef RECONSTRUCT_FIELD
    place_on_surface = Place(position, normal);
#endif
#ifdef INDIRECT
    vec3 indirect = indirect_irradiance(lightmap_uv);
#ifdef TILTED
    indirect = max(indirect + change_by_tilt(lightmap_uv, facing - normal), vec3(0.0));
#endif
#ifdef TRANSLUCENT
    if (colour.r < 0.0) irradiance += indirect;
#else
    irradiance += indirect;
#endif
#endif
    vec3 reflectance = albedo;
#ifdef ALBEDO_IMAGE
    reflectance *= texture(albedo_image, image_uv).rgb;
#endif
    radiance = vec4(reflectance / PI * irradiance, 1.0);
#ifdef TRANSLUCENT
    radiance.rgb += max(colour, vec3(0.0)) / PI * indirect;
#endif
#ifdef GLOSSY
    if (specular != vec3(0.0)) {
        float sharpness = exponent;
#ifdef ROUGHNESS_IMAGE
        float roughness = texture(roughness_image, image_uv).r;
        if (exponent < 0.0) sharpness = 2.0 / (roughness * roughness) - 2.0;
#endif
        vec3 mirror = reflect(normalize(position - eye), facing);
        radiance.rgb += specular * max(gloss(lightmap_uv, mirror, sharpness), vec3(0.0));
#ifdef DIRECTIONAL
#ifdef DIRECT
        radiance.rgb += specular * gloss_of_emitters(position, facing, mirror, sharpness);
#endif
#endif
    }
#endif
}
