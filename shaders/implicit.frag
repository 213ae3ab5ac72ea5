// An implicit surface on a screen: each pixel's ray is sphere traced through the generated distance. With HITS_ONLY the place, the
// normal and the part of what it meets go to images for a compute pass; else the pixel is shaded here, by the network.
#include "dual.glsl"
#include "generated/distance"
#ifndef HITS_ONLY
#include "surface.glsl"
#else
uniform vec3 eye;
#endif

in vec2 screen;
uniform mat4 from_screen;  // clip space to directions from the eye

#ifdef HITS_ONLY
layout(location = 0) out vec4 hit_position;  // w: 1 + the part that was met
layout(location = 1) out vec4 hit_normal;
#else
out vec4 radiance;
#endif

void main() {
    vec3 direction = normalize((from_screen * vec4(screen, 1.0, 1.0)).xyz);
    vec3 a = (BOX_LOW - eye) / direction, b = (BOX_HIGH - eye) / direction;
    vec3 first = min(a, b), last = max(a, b);
    float t = max(max(max(first.x, first.y), first.z), 0.0), far = min(min(last.x, last.y), last.z);
    bool met = false;
    float d = far;
    for (int step = 0; step < STEPS && t < far; ++step) {
        d = distance_at(eye + t * direction);
        met = d < TOLERANCE;
        if (met) break;
        t += STEP_SHARE * d;
    }
    if (!met && (t >= far || d >= CREEPING)) discard;
    vec3 position = eye + t * direction;
    vec3 slope = sloped_distance(position).xyz;
    float steepness = length(slope);
    vec3 normal = steepness > 1e-4 ? slope / steepness : vec3(0.0, 1.0, 0.0);
    int part = part_at(position);
#ifdef HITS_ONLY
    hit_position = vec4(position, float(1 + part));
    hit_normal = vec4(normal, 0.0);
#else
    vec4 rows[ROWS * LAYERS];
    transfer_vectors(Place(position, normal), rows);
    radiance = vec4(radiance_of(position, normal, part, rows), 1.0);
#endif
}
