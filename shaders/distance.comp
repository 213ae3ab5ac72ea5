// Signed distance and its gradient at given places, for comparison with the expression in JAX.
#include "dual.glsl"
#include "generated/distance"

layout(local_size_x = 64) in;

layout(std430, binding = 6) buffer Places { vec4 places[]; };  // in: place, out: gradient and distance by dual numbers
layout(std430, binding = 7) writeonly buffer Plain { float plain[]; };

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= PLACES) return;
    vec3 p = places[i].xyz;
    places[i] = sloped_distance(p);
    plain[i] = distance_at(p);
}
