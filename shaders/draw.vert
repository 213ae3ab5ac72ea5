// The mesh from the camera. Without a fragment stage it fills the depth buffer alone.
in vec3 in_position;
#ifdef SHADED
in vec3 in_normal;
in vec2 in_lightmap_uv;
in vec2 in_image_uv;
in vec3 in_albedo;

out vec3 position;
out vec2 lightmap_uv;
out vec2 image_uv;
flat out vec3 normal;
flat out vec3 albedo;
#ifdef NORMAL_IMAGE
in vec3 in_tangent;
in vec3 in_bitangent;
flat out vec3 tangent;
flat out vec3 bitangent;
#endif
#ifdef TRANSLUCENT
in vec3 in_colour;
flat out vec3 colour;
#endif
#ifdef HAIR
in vec3 in_fibre;
in float in_clearance;
in int in_hair;
out vec3 fibre;
flat out float clearance;
flat out int hair;
#endif
#ifdef GLOSSY
in vec3 in_specular;
in float in_exponent;
flat out vec3 specular;
flat out float exponent;
#endif
#ifdef RECONSTRUCT_VERTICES
in int in_vertex;
layout(std430, binding = 8) readonly buffer Light { vec4 light[]; };
out vec3 vertex_light;
#endif
#endif

uniform mat4 camera;

invariant gl_Position;

void main() {
    gl_Position = camera * vec4(in_position, 1.0);
#ifdef SHADED
    position = in_position;
    normal = in_normal;
    lightmap_uv = in_lightmap_uv;
    image_uv = in_image_uv;
    albedo = in_albedo;
#ifdef NORMAL_IMAGE
    tangent = in_tangent;
    bitangent = in_bitangent;
#endif
#ifdef TRANSLUCENT
    colour = in_colour;
#endif
#ifdef HAIR
    fibre = in_fibre;
    clearance = in_clearance;
    hair = in_hair;
#endif
#ifdef GLOSSY
    specular = in_specular;
    exponent = in_exponent;
#endif
#ifdef RECONSTRUCT_VERTICES
    vertex_light = light[in_vertex].rgb;
#endif
#endif
}
