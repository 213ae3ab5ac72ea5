// A rigid body that moves: its own mesh, placed by `pose`.
in vec3 in_position;
in vec3 in_normal;

uniform mat4 camera;
uniform mat4 pose;

out vec3 position;
flat out vec3 normal;

void main() {
    vec4 place = pose * vec4(in_position, 1.0);
    position = place.xyz;
    normal = normalize(mat3(pose) * in_normal);
    gl_Position = camera * place;
}
