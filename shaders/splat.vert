// A square about the disk in the surface of a sample over which its light is spread; on the screen the disk is an ellipse. It is at
// least a pixel wide. Its depth is that of a place nearer to the eye, so that the surface itself does not hide it.
in vec4 in_position;
in vec4 in_normal;
in vec4 in_tangent;
in vec4 in_walls;
in vec4 in_further_walls;
in vec4 in_direct;
in vec4 in_open;
in vec4 in_indirect;

uniform mat4 camera;
uniform vec3 eye;
uniform float pixel;  // its width in the world per unit of clip w

flat out vec3 centre;
flat out mat3 frame;
flat out float reach;
flat out vec4 walls;
flat out vec4 further_walls;
flat out vec3 light;
flat out vec3 share;

void main() {
    centre = in_position.xyz;
    vec3 normal = in_normal.xyz, tangent = in_tangent.xyz;
    frame = mat3(tangent, cross(normal, tangent), normal);
    walls = in_walls;
    further_walls = in_further_walls;
    light = in_indirect.rgb;
    share = mix(in_direct.rgb / max(in_open.rgb, 1e-30), vec3(0.0), lessThanEqual(in_open.rgb, vec3(1e-30)));
    reach = max(in_normal.w, pixel * (camera * vec4(centre, 1.0)).w);
    if (dot(eye - centre, normal) <= 0.0) {
        gl_Position = vec4(0.0, 0.0, 2.0, 1.0);  // clipped
        return;
    }
    vec2 corner = 2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1.0;
    vec3 place = centre + reach * (frame * vec3(corner, 0.0));
    vec4 at = camera * vec4(place, 1.0);
    vec4 nearer = camera * vec4(mix(place, eye, min(BIAS * reach / distance(place, eye), 0.5)), 1.0);
    gl_Position = vec4(at.xy, nearer.z * at.w / nearer.w, at.w);
}
