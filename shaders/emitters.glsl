// Punctual emitters and the irradiance they cause: the same formulas as prt_bench/emitters.py.
// Measurement and final frame both come here; SHADOWS compiles the shadow lookup in.

struct Emitter {
    vec4 position;   // homogeneous: w = 1 a point, w = 0 a unit direction towards the light
    vec4 axis;       // xyz: unit axis of emission, w: index of its first shadow view
    vec4 intensity;  // rgb: W/sr for points, W/m² for directions, w: number of shadow views
    vec4 profile;    // cosines of outer and inner cone, weight of the Lambert cosine, squared source radius
};

layout(std430, binding = 0) readonly buffer Emitters {
    int emitter_count;
    Emitter emitters[];
};

#ifdef SHADOWS
#include "shadow.glsl"
#endif

// Angular profile over squared distance.
float attenuation(Emitter e, vec3 direction, float distance_squared) {
    float cosine = -dot(direction, e.axis.xyz);
    float t = clamp((cosine - e.profile.x) / max(e.profile.y - e.profile.x, 1e-6), 0.0, 1.0);
    float profile = t * t * (3.0 - 2.0 * t) * (1.0 + e.profile.z * (max(cosine, 0.0) - 1.0));
    return e.position.w > 0.0 ? profile / (distance_squared + e.profile.w) : profile;
}

// What an emitter that nothing hides causes at a surface point per unit of intensity; `incidence` is the cosine there.
float strength(Emitter e, vec3 position, vec3 normal, out float incidence) {
    vec3 offset = e.position.xyz - position * e.position.w;
    float distance_squared = dot(offset, offset);
    vec3 direction = offset * inversesqrt(max(distance_squared, 1e-30));
    incidence = max(dot(normal, direction), 0.0);
    return incidence * attenuation(e, direction, distance_squared);
}

// Direct irradiance in W/m² at a surface point.
vec3 direct_irradiance(vec3 position, vec3 normal) {
    vec3 sum = vec3(0.0);
    for (int i = 0; i < emitter_count; ++i) {
        Emitter e = emitters[i];
        float incidence, found = strength(e, position, normal, incidence);
        if (found > 0.0) {
#ifdef SHADOWS
            found *= visibility(e, position, normal, incidence);
#endif
            sum += found * e.intensity.rgb;
        }
    }
    return sum;
}
