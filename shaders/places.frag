// Which surface each pixel shows: its place, with 1 where there is one, and its normal.
in vec3 position;
flat in vec3 normal;

layout(location = 0) out vec4 place;
layout(location = 1) out vec4 facing;

void main() {
    place = vec4(position, 1.0);
    facing = vec4(normal, 0.0);
}
