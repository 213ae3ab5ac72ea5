// Light from a basis for each cluster of receivers. A texel holds CLUSTER_BASIS values, then the number of its cluster. Values of
// different clusters belong to different functions: where the four texels about a place are of one cluster the texture unit
// interpolates them, elsewhere their light is interpolated. Halved images would mix clusters, so the full one is read.

int cluster_at(ivec2 texel) {
    return int(texelFetch(basis, ivec3(texel, CLUSTER_BASIS / 4), 0)[CLUSTER_BASIS % 4]);
}

vec3 times_coefficients(vec4 phi, int layer, int cluster) {
    vec3 sum = vec3(0.0);
    for (int b = 4 * layer; b < min(4 * layer + 4, CLUSTER_BASIS); ++b) {
        sum += phi[b % 4] * coefficients[CLUSTER_BASIS * cluster + b].rgb;
    }
    return sum;
}

vec3 texel_light(ivec2 texel, int cluster) {
    vec3 sum = vec3(0.0);
    for (int layer = 0; 4 * layer < CLUSTER_BASIS; ++layer) {
        sum += times_coefficients(texelFetch(basis, ivec3(texel, layer), 0), layer, cluster);
    }
    return sum;
}

vec3 clustered_light(vec2 uv) {
    ivec2 last = textureSize(basis, 0).xy - 1;
    vec2 place = uv * vec2(last + 1) - 0.5;
    ivec2 corner = ivec2(floor(place));
    vec2 share = place - vec2(corner);
    ivec2 low = clamp(corner, ivec2(0), last), high = clamp(corner + 1, ivec2(0), last);
    int a = cluster_at(low), b = cluster_at(ivec2(high.x, low.y)), c = cluster_at(ivec2(low.x, high.y)), d = cluster_at(high);
    if (a == b && a == c && a == d) {
        vec3 sum = vec3(0.0);
        for (int layer = 0; 4 * layer < CLUSTER_BASIS; ++layer) {
            sum += times_coefficients(textureLod(basis, vec3(uv, layer), 0.0), layer, a);
        }
        return sum;
    }
    vec3 below = mix(texel_light(low, a), texel_light(ivec2(high.x, low.y), b), share.x);
    vec3 above = mix(texel_light(ivec2(low.x, high.y), c), texel_light(high, d), share.x);
    return mix(below, above, share.y);
}
