"""The scene's mesh on the GPU: one vertex per face corner, sorted by material so that an albedo image is bound once."""

from itertools import pairwise

import moderngl
import numpy as np
from jaxtyping import Float, Int

from prt_bench.points import Lightmap
from prt_bench.runtime.fibres import Fibres
from prt_bench.scene import Material, Scene


class MeshBuffers:
    """Vertex attributes (flat geometric normals, which normal images tilt as in the transport) and the vertex range of
    each material's images.

    `corner` is the vertex of each face corner where transfer is stored at vertices, `colour` that of translucent bodies.
    """

    def __init__(
        self,
        context: moderngl.Context,
        scene: Scene,
        lightmap: Lightmap,
        corner: Int[np.ndarray, "F 3"] | None = None,
        colour: Float[np.ndarray, "materials 3"] | None = None,
    ) -> None:
        self._context = context
        mesh, materials = scene.mesh, scene.materials
        order = np.argsort(mesh.material, kind="stable")
        owner = mesh.material[order]
        image_uv = np.zeros((len(order), 3, 2)) if mesh.uv is None else mesh.uv[order]
        per_corner = {
            "in_position": mesh.triangles[order],
            "in_normal": _thrice(mesh.normals[order]),
            "in_lightmap_uv": lightmap.corner_uv[order],
            "in_image_uv": image_uv,
            "in_albedo": _per_corner(np.array([m.albedo for m in materials]), owner),
            "in_specular": _per_corner(np.array([_lobe(m)[:3] for m in materials]), owner),
            **self._frames(scene, order),
            **self._colours(scene, order, colour),
            **_fibres(scene, order),
            "in_exponent": _per_corner(np.array([_lobe(m)[3:] for m in materials]), owner),
        }
        self._attributes = {
            name: (context.buffer(np.ascontiguousarray(values, "<f4").tobytes()), f"{values.shape[-1]}f4")
            for name, values in per_corner.items()
        }
        self.hair = None if scene.strands is None else Fibres(context, materials)
        if self.hair is not None:
            layer = np.where(order < scene.surfaces, -1, np.asarray(self.hair.layer)[owner])
            self._attributes["in_hair"] = (context.buffer(np.repeat(layer, 3).astype("<i4").tobytes()), "1i4")
        if corner is not None:
            self._attributes["in_vertex"] = (context.buffer(corner[order].astype("<i4").tobytes()), "1i4")
        self.vertices = 3 * len(order)
        self.has_images = any(material.image is not None for material in materials)
        self.has_roughness = any(m.glossy is not None and m.glossy.roughness_image is not None for m in materials)
        starts = 3 * np.searchsorted(owner, np.arange(len(materials) + 1))
        self.translucent = colour is not None
        self.has_normals = any(m.normal_image is not None for m in materials)
        self.ranges: list[tuple[int, int, dict[int, moderngl.Texture]]] = [(0, self.vertices, {})]
        if self.has_images or self.has_roughness or self.has_normals:
            self.ranges = [
                (int(first), int(last - first), self._images(context, material))
                for material, (first, last) in zip(materials, pairwise(starts), strict=True)
                if last > first
            ]

    def _images(self, context: moderngl.Context, material: Material) -> dict[int, moderngl.Texture]:
        """A material's textures by the unit they are bound to."""
        albedo = {2: _albedo_texture(context, material)} if self.has_images else {}
        roughness = {7: _roughness_texture(context, material)} if self.has_roughness else {}
        return albedo | roughness | ({8: _normal_texture(context, material)} if self.has_normals else {})

    @staticmethod
    def _frames(scene: Scene, order: np.ndarray) -> dict[str, np.ndarray]:
        """Directions along u and v of each corner, where a normal image is read in them."""
        if all(material.normal_image is None for material in scene.materials):
            return {}
        tangent, bitangent, _ = np.moveaxis(scene.tangent_frames(order), 1, 0)
        return {"in_tangent": _thrice(tangent), "in_bitangent": _thrice(bitangent)}

    @staticmethod
    def _colours(
        scene: Scene, order: np.ndarray, colour: Float[np.ndarray, "materials 3"] | None
    ) -> dict[str, np.ndarray]:
        """Colours of translucent bodies at the corners of their faces, −1 at others, where there are any."""
        if colour is None:
            return {}
        return {
            "in_colour": _thrice(
                np.where(scene.translucent_at(order)[:, None], colour[scene.mesh.material[order]], -1.0)
            )
        }

    def bound_to(self, program: moderngl.Program) -> moderngl.VertexArray:
        """A vertex array with the attributes the program uses."""
        content = [(buffer, layout, name) for name, (buffer, layout) in self._attributes.items() if name in program]
        return self._context.vertex_array(program, content)


def _fibres(scene: Scene, order: np.ndarray) -> dict[str, np.ndarray]:
    """Tangents of strands at the corners of their tubes, smooth along them, and how far their tubes reach; 0 on surfaces."""
    strands = scene.strands
    if strands is None:
        return {}
    node = strands.corners[0]
    tangent = np.zeros_like(strands.nodes)
    tangent[strands.first] += strands.tangents
    tangent[strands.first + 1] += strands.tangents
    fibre = np.concatenate([np.zeros((scene.surfaces, 3, 3)), tangent[node]])
    clearance = np.concatenate([np.zeros((scene.surfaces, 3)), strands.clearance[strands.owner[node]]])
    return {"in_fibre": fibre[order], "in_clearance": clearance[order][..., None]}


def _albedo_texture(context: moderngl.Context, material: Material) -> moderngl.Texture:
    """The material's image, bottom row first; a white texel where it has none."""
    image = np.ones((1, 1, 3)) if material.image is None else material.image[::-1]
    height, width = image.shape[:2]
    texture = context.texture((width, height), 3, np.ascontiguousarray(image, "<f4").tobytes(), dtype="f4")
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return texture


def _roughness_texture(context: moderngl.Context, material: Material) -> moderngl.Texture:
    """The material's roughness image, bottom row first; one texel where it has none."""
    image = None if material.glossy is None else material.glossy.roughness_image
    rows = np.ones((1, 1)) if image is None else image[::-1]
    texture = context.texture(rows.shape[::-1], 1, np.ascontiguousarray(rows, "<f4").tobytes(), dtype="f4")
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return texture


def _lobe(material: Material) -> tuple[float, float, float, float]:
    """Specular reflectance and exponent; the exponent is −1 where an image has its place."""
    lobe = material.glossy
    if lobe is None:
        return 0.0, 0.0, 0.0, 0.0
    return *lobe.specular, lobe.exponent if lobe.roughness_image is None else -1.0


def _normal_texture(context: moderngl.Context, material: Material) -> moderngl.Texture:
    """The material's normal image, bottom row first; one upright texel where it has none."""
    image = np.array([[[0.0, 0.0, 1.0]]]) if material.normal_image is None else material.normal_image[::-1]
    height, width = image.shape[:2]
    texture = context.texture((width, height), 3, np.ascontiguousarray(image, "<f4").tobytes(), dtype="f4")
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return texture


def _per_corner(values: np.ndarray, owner: np.ndarray) -> np.ndarray:
    return _thrice(values[owner])


def _thrice(per_face: np.ndarray) -> np.ndarray:
    return np.repeat(per_face[:, None], 3, axis=1)
