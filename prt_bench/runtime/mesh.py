"""The scene's mesh on the GPU: one vertex per face corner, sorted by material so that an albedo image is bound once."""

from itertools import pairwise

import moderngl
import numpy as np
from jaxtyping import Int

from prt_bench.points import Lightmap
from prt_bench.scene import Material, Scene


class MeshBuffers:
    """Vertex attributes (flat geometric normals, as in the transport) and the vertex range of each albedo image.

    `corner` is the vertex of each face corner where transfer is stored at vertices.
    """

    def __init__(
        self, context: moderngl.Context, scene: Scene, lightmap: Lightmap, corner: Int[np.ndarray, "F 3"] | None = None
    ) -> None:
        self._context = context
        mesh, materials = scene.mesh, scene.materials
        order = np.argsort(mesh.material, kind="stable")
        owner = mesh.material[order]
        image_uv = np.zeros((len(order), 3, 2)) if mesh.uv is None else mesh.uv[order]
        per_corner = {
            "in_position": mesh.triangles[order],
            "in_normal": np.repeat(mesh.normals[order][:, None], 3, axis=1),
            "in_lightmap_uv": lightmap.corner_uv[order],
            "in_image_uv": image_uv,
            "in_albedo": np.repeat(np.array([m.albedo for m in materials])[owner][:, None], 3, axis=1),
        }
        self._attributes = {
            name: (context.buffer(np.ascontiguousarray(values, "<f4").tobytes()), f"{values.shape[-1]}f4")
            for name, values in per_corner.items()
        }
        if corner is not None:
            self._attributes["in_vertex"] = (context.buffer(corner[order].astype("<i4").tobytes()), "1i4")
        self.vertices = 3 * len(order)
        self.has_images = any(material.image is not None for material in materials)
        starts = 3 * np.searchsorted(owner, np.arange(len(materials) + 1))
        self.ranges: list[tuple[int, int, moderngl.Texture | None]] = [(0, self.vertices, None)]
        if self.has_images:
            self.ranges = [
                (int(first), int(last - first), _albedo_texture(context, material))
                for material, (first, last) in zip(materials, pairwise(starts), strict=True)
                if last > first
            ]

    def bound_to(self, program: moderngl.Program) -> moderngl.VertexArray:
        """A vertex array with the attributes the program uses."""
        content = [(buffer, layout, name) for name, (buffer, layout) in self._attributes.items() if name in program]
        return self._context.vertex_array(program, content)


def _albedo_texture(context: moderngl.Context, material: Material) -> moderngl.Texture:
    """The material's image, bottom row first; a white texel where it has none."""
    image = np.ones((1, 1, 3)) if material.image is None else material.image[::-1]
    height, width = image.shape[:2]
    texture = context.texture((width, height), 3, np.ascontiguousarray(image, "<f4").tobytes(), dtype="f4")
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return texture
