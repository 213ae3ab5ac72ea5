// Irradiance from a volume of probes, as ProbeVolume.irradiance of prt_bench/irradiance_volume.py has it: nine coefficients a
// probe, interpolated trilinearly between those that are not in bodies. CELLS is the grid, ORDER 3; ROOM probes along an edge are a
// room, and others count where that is open to theirs.
#include "generated/harmonics"

layout(std430, binding = 9) readonly buffer Probes { vec4 probes[]; };  // [P, 9]: W/m², w of the first: 0 in a body, else 1
#ifdef ROOM
layout(std430, binding = 10) readonly buffer Open { int open_to[]; };  // [P]: bits of the 27 rooms around a probe's
#endif
uniform vec3 volume_low;
uniform vec3 volume_high;

int probe_number(ivec3 at) { return (at.x * CELLS.y + at.y) * CELLS.z + at.z; }

vec3 probe_irradiance(vec3 position, vec3 normal) {
    vec3 place = (position - volume_low) / (volume_high - volume_low) * vec3(CELLS) - 0.5;
    place = clamp(place, vec3(0.0), vec3(CELLS) - 1.0);
    ivec3 first = min(ivec3(place), max(CELLS - 2, ivec3(0)));
    vec3 along = place - vec3(first);
#ifdef ROOM
    ivec3 here = ivec3(place + 0.5);
    int doors = open_to[probe_number(here)];
#endif
    float y[9];
    harmonics(normal, y);
    vec3 sum = vec3(0.0);
    float total = 0.0;
    for (int corner = 0; corner < 8; ++corner) {
        ivec3 ahead = ivec3(corner & 1, (corner >> 1) & 1, corner >> 2);
        ivec3 at = min(first + ahead, CELLS - 1);
        int start = 9 * probe_number(at);
        vec3 share = mix(1.0 - along, along, vec3(ahead));
        float weight = share.x * share.y * share.z * probes[start].w;
#ifdef ROOM
        ivec3 around = at / ROOM - here / ROOM + 1;
        if ((doors >> (9 * around.x + 3 * around.y + around.z) & 1) == 0) continue;
#endif
        if (weight == 0.0) continue;
        vec3 here = vec3(0.0);
        for (int k = 0; k < 9; ++k) here += y[k] * probes[start + k].rgb;
        sum += weight * here;
        total += weight;
    }
    return total > 0.0 ? sum / total : vec3(0.0);
}
