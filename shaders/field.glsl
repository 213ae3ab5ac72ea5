// Indirect light from a neural field: a network gives the basis functions at a place on the surface, and their coefficients
// are summed as with textures. With ROWS they are transfer vectors, LAYERS fours each, and add to that of an open surface. GRIDS of features are interpolated by hand, since samplers round what they interpolate.
#include "network.glsl"

struct Place { vec3 position; vec3 normal; };
Place place_on_surface;  // set before the light is asked for

layout(std430, binding = 11) readonly buffer Biases { ivec4 turns[DEPTH]; vec4 biases[]; };

#if LEVELS > 0
const int SIDES[LEVELS] = int[](GRID_SIDES);
const int STARTS[LEVELS] = int[](GRID_STARTS);
#ifdef HALF
layout(std430, binding = 12) readonly buffer Grids { uint grids[]; };

vec2 node(int at) { return unpackHalf2x16(grids[at]); }
#else
layout(std430, binding = 12) readonly buffer Grids { vec2 grids[]; };

vec2 node(int at) { return grids[at]; }
#endif

vec2 looked_up(int level, vec3 place) {
    int side = SIDES[level];
    vec3 at = clamp((place * 0.5 + 0.5) * float(side - 1), vec3(0.0), vec3(float(side - 1)));
    ivec3 low = min(ivec3(at), ivec3(side - 2));
    vec3 share = at - vec3(low);
    vec2 sum = vec2(0.0);
    for (int corner = 0; corner < 8; ++corner) {
        ivec3 up = ivec3(corner & 1, (corner >> 1) & 1, corner >> 2);
        vec3 weight = mix(1.0 - share, share, vec3(up));
        ivec3 cell = low + up;
        sum += weight.x * weight.y * weight.z * node(STARTS[level] + cell.x + side * (cell.y + side * cell.z));
    }
    return sum;
}
#else
vec2 looked_up(int level, vec3 place) { return vec2(0.0); }
#endif

// Place, normal, sines and cosines of OCTAVES, features of LEVELS; what is left of the last four is 0.
void encode(vec3 place, vec3 normal, inout vec4 a[INPUTS]) {
    float x[4 * ENCODED];
    x[0] = place.x; x[1] = place.y; x[2] = place.z;
    x[3] = normal.x; x[4] = normal.y; x[5] = normal.z;
    for (int i = 6; i < 4 * ENCODED; ++i) x[i] = 0.0;
    int at = 6;
    for (int octave = 0; octave < OCTAVES; ++octave) {
        vec3 angle = exp2(float(octave)) * 3.14159265358979 * place;
        vec3 s = sin(angle), c = cos(angle);
        x[at] = s.x; x[at + 1] = s.y; x[at + 2] = s.z;
        x[at + 3] = c.x; x[at + 4] = c.y; x[at + 5] = c.z;
        at += 6;
    }
    for (int level = 0; level < LEVELS; ++level) {
        vec2 found = looked_up(level, place);
        x[at] = found.x; x[at + 1] = found.y;
        at += 2;
    }
    for (int i = 0; i < ENCODED; ++i) a[i] = vec4(x[4 * i], x[4 * i + 1], x[4 * i + 2], x[4 * i + 3]);
}

#ifdef SHARED_WEIGHTS
#include "generated/shared_field"
#else
#include "generated/field"
#endif

#ifdef ROWS
#include "generated/open"

void transfer_vectors(Place place, out vec4 rows[ROWS * LAYERS]) {
    field((place.position - BOX_MIDDLE) * BOX_SCALE, place.normal, rows);
    float open[HARMONICS];
    open_surface(place.normal, open);
    for (int layer = 0; layer < LAYERS; ++layer) {
        vec4 four_of = vec4(0.0);
        for (int i = 0; i < 4; ++i)
            if (4 * layer + i < HARMONICS) four_of[i] = open[4 * layer + i];
        for (int row = 0; row < ROWS; ++row) rows[row * LAYERS + layer] += four_of;
    }
}

// Irradiance from the first rows: one for all channels, or one each.
vec3 irradiance_of(vec4 rows[ROWS * LAYERS]) {
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        mat4x3 u = mat4x3(coefficients[b].rgb, coefficients[b + 1].rgb, coefficients[b + 2].rgb, coefficients[b + 3].rgb);
#if DIFFUSE_ROWS == 1
        sum += u * rows[layer];
#else
        mat3x4 by_channel = transpose(u);
        for (int c = 0; c < 3; ++c) sum[c] += dot(by_channel[c], rows[c * LAYERS + layer]);
#endif
    }
    return sum;
}

vec3 field_light() {
    vec4 rows[ROWS * LAYERS];
    transfer_vectors(place_on_surface, rows);
    return irradiance_of(rows);
}
#else
vec3 field_light() {
    vec4 phi[LAYERS];
    field((place_on_surface.position - BOX_MIDDLE) * BOX_SCALE, place_on_surface.normal, phi);
    vec3 sum = vec3(0.0);
    for (int layer = 0; layer < LAYERS; ++layer) {
        int b = 4 * layer;
        sum += mat4x3(coefficients[b].rgb, coefficients[b + 1].rgb, coefficients[b + 2].rgb, coefficients[b + 3].rgb) * phi[layer];
    }
    return sum;
}
#endif
