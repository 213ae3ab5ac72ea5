"""Meshes in users' own files, read by trimesh into a `Scene`: geometry, base colours as albedo, scale and a camera.

Colours: factors (glTF base colour, OBJ Kd) and glTF vertex colours are linear as they stand; images and the 8-bit
vertex and face colours of other formats are sRGB. A surface without colour is 0.5 grey. Scene files (.toml) are read
by `scene_file.py`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial

from data_gen.geometry import Part, assemble, is_closed, repair, rotation_about, with_both_sides
from prt_bench.errors import SceneError
from prt_bench.scene import Camera, Material, Scene

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl")
LONGEST_SIDE = 2.0
"""Size in metres given to meshes whose format has no unit."""
_METRIC = (".glb", ".gltf")
_GREY = (0.5, 0.5, 0.5)
_TO_Y_UP = {"x": rotation_about(2, 90.0), "y": np.eye(3), "z": rotation_about(0, -90.0)}


@dataclass(frozen=True)
class MeshOptions:
    """What a scene file may say about its mesh.

    `scale` is metres per unit of the file (None: glTF is in metres, any other mesh is made 2 m long), `up` the file's
    vertical axis (x, y or z), `materials` the fields of `Material` to replace, by material name. A given albedo
    replaces the material's image too.
    """

    name: str | None = None
    scale: float | None = None
    up: str = "y"
    camera: Camera | None = None
    materials: Mapping[str, Mapping[str, Any]] | None = None


def read_mesh(path: Path, options: MeshOptions | None = None) -> Scene:
    """Read a mesh file. Raises `SceneError` when it is missing, unreadable, empty or defective beyond repair."""
    options = options or MeshOptions()
    parts, materials, notes = _parts(path)
    materials = _replaced(materials, options.materials or {}, path)
    mesh, repairs = repair(assemble(parts), f"mesh {path.name}")
    notes += repairs
    mesh = replace(mesh, vertices=mesh.vertices @ _TO_Y_UP[options.up].T)
    scale = options.scale
    if scale is None:
        longest = float(np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0).max())
        scale = 1.0 if path.suffix.lower() in _METRIC else LONGEST_SIDE / longest
        if scale != 1.0:
            notes += (f"scaled by {scale:.4g} to make the longest side {LONGEST_SIDE:g} m, as its format has no unit",)
    mesh = with_both_sides(replace(mesh, vertices=mesh.vertices * scale), materials)
    scene = Scene(
        options.name or path.stem, mesh, tuple(materials), options.camera or Camera((0, 0, 1), (0, 0, 0)), notes
    )
    return scene if options.camera else replace(scene, camera=_fitting_camera(scene))


def _parts(path: Path) -> tuple[list[Part], list[Material], tuple[str, ...]]:
    """Every mesh of the file's scene graph in its place, and the materials they name."""
    parts: list[Part] = []
    materials: list[Material] = []
    index: dict[int, int] = {}
    notes: tuple[str, ...] = ()
    graph = _open(path)
    factors = _gltf_factors(path) if path.suffix.lower() in _METRIC else {}
    for node in sorted(graph.graph.nodes_geometry):
        matrix, name = graph.graph[node]
        geometry = graph.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            notes += (f"left out '{name}', which has no triangles",)
            continue
        source = id(geometry.visual.material if isinstance(geometry.visual, TextureVisuals) else geometry)
        if source not in index:
            index[source] = len(materials)
            materials.append(_material(geometry, path, factors))
        part = Part(np.array(geometry.vertices, float), np.array(geometry.faces), index[source])
        if materials[part.material].image is not None:
            part = replace(part, uv=_texture_coordinates(geometry, path))
        parts.append(_placed(part, matrix))
    if not parts:
        raise SceneError(f"mesh {path} has no triangles; a scene needs a surface to light")
    if any(part.uv is not None for part in parts):
        parts = [replace(p, uv=np.zeros((len(p.faces), 3, 2))) if p.uv is None else p for p in parts]
    for at, material in enumerate(materials):
        if material.two_sided and all(is_closed(part) for part in parts if part.material == at):
            materials[at] = replace(material, two_sided=False)
            notes += (f"'{material.name}' is two-sided but encloses a volume: its inside is left out",)
    return parts, _with_distinct_names(materials), notes


def _open(path: Path) -> trimesh.Scene:
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path} is not a mesh that can be read; the formats are {', '.join(FORMATS)}")
    if not path.is_file():
        raise SceneError(f"mesh {path} does not exist")
    try:
        return trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh's readers raise whatever their parsing trips over
        raise SceneError(
            f"mesh {path} could not be read ({type(error).__name__}: {error}); is the file whole?"
        ) from error


def _placed(part: Part, matrix: Float[np.ndarray, "4 4"]) -> Part:
    """A part moved to its place in the scene graph; a mirrored one keeps its front outside."""
    moved = part.transformed(matrix[:3, :3], matrix[:3, 3])
    if np.linalg.det(matrix[:3, :3]) >= 0:
        return moved
    return replace(moved, faces=moved.faces[:, ::-1], uv=None if moved.uv is None else moved.uv[:, ::-1])


def _material(geometry: trimesh.Trimesh, path: Path, gltf_factors: Mapping[str, Sequence[float]]) -> Material:
    visual = geometry.visual
    name = str(geometry.metadata.get("name") or path.stem)
    if not isinstance(visual, TextureVisuals):
        return _coloured(geometry, name, linear=path.suffix.lower() in _METRIC)
    material = visual.material
    name = material.name or name
    if isinstance(material, PBRMaterial):
        factor, image, two_sided = gltf_factors.get(name), material.baseColorTexture, bool(material.doubleSided)
    else:
        factor, image, two_sided = material.kwargs.get("kd"), material.image, False
    texture = None if image is None or visual.uv is None else _linear(np.asarray(image.convert("RGB")))
    if factor is None:
        factor = _GREY if texture is None else (1.0, 1.0, 1.0)
    return Material(name, (float(factor[0]), float(factor[1]), float(factor[2])), texture, two_sided)


def _gltf_factors(path: Path) -> dict[str, Sequence[float]]:
    """Base colour factors by material name, from the file itself: trimesh clips and rounds them to 8 bits."""
    content = path.read_bytes()
    if content[:4] == b"glTF":
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    return {
        material["name"]: material["pbrMetallicRoughness"]["baseColorFactor"]
        for material in json.loads(content).get("materials", [])
        if "name" in material and "baseColorFactor" in material.get("pbrMetallicRoughness", {})
    }


def _coloured(geometry: trimesh.Trimesh, name: str, linear: bool) -> Material:
    """Vertex or face colours, averaged over each face, as one colour or as an image with a texel per colour."""
    if geometry.visual is None or not geometry.visual.defined:
        return Material(name, _GREY)
    palette, _ = _palette(geometry, linear)
    if len(palette) == 1:
        red, green, blue = palette[0].tolist()
        return Material(name, (red, green, blue))
    side = _palette_side(len(palette))
    image = np.zeros((side * side, 3), np.float32)
    image[: len(palette)] = palette
    return Material(name, (1.0, 1.0, 1.0), image.reshape(side, side, 3))


def _texture_coordinates(geometry: trimesh.Trimesh, path: Path) -> Float[np.ndarray, "F 3 2"]:
    if isinstance(geometry.visual, TextureVisuals):
        return np.asarray(geometry.visual.uv, float)[geometry.faces]
    palette, which = _palette(geometry, linear=path.suffix.lower() in _METRIC)
    side = _palette_side(len(palette))
    row, column = np.divmod(which, side)
    centre = np.stack([(column + 0.5) / side, 1.0 - (row + 0.5) / side], axis=1)
    return np.repeat(centre[:, None], 3, axis=1)


def _palette(geometry: trimesh.Trimesh, linear: bool) -> tuple[Float[np.ndarray, "K 3"], Int[np.ndarray, " F"]]:
    """The distinct colours of a mesh without textures, and which of them each face has."""
    visual = geometry.visual
    assert isinstance(visual, ColorVisuals)
    colours = visual.vertex_colors[geometry.faces] if visual.kind == "vertex" else visual.face_colors[:, None]
    values = colours[..., :3] / np.float32(255.0) if linear else _linear(colours[..., :3])
    palette, which = np.unique(values.mean(axis=1, dtype=np.float32), axis=0, return_inverse=True)
    return palette, which.reshape(-1)


def _palette_side(colours: int) -> int:
    return int(np.ceil(np.sqrt(colours)))


def _linear(srgb: np.ndarray) -> Float[np.ndarray, "*shape 3"]:
    """8-bit sRGB to linear values (IEC 61966-2-1)."""
    value = srgb.astype(np.float32) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _with_distinct_names(materials: list[Material]) -> list[Material]:
    seen: dict[str, int] = {}
    named = []
    for material in materials:
        count = seen[material.name] = seen.get(material.name, 0) + 1
        named.append(material if count == 1 else replace(material, name=f"{material.name}-{count}"))
    return named


def _replaced(materials: list[Material], overrides: Mapping[str, Mapping[str, Any]], path: Path) -> list[Material]:
    names = [material.name for material in materials]
    for name in overrides:
        if name not in names:
            raise SceneError(f"mesh {path} has no material '{name}'; it has {', '.join(repr(n) for n in names)}")
    return [
        replace(m, **({"image": None} if "albedo" in overrides.get(m.name, {}) else {}), **overrides.get(m.name, {}))
        for m in materials
    ]


def _fitting_camera(scene: Scene, fov_y: float = 40.0) -> Camera:
    """A camera from the front, a little above and to the right, that holds the bounding sphere."""
    centre = scene.bounds.mean(axis=0)
    direction = np.array([0.35, 0.3, 1.0]) / np.linalg.norm([0.35, 0.3, 1.0])
    distance = 0.5 * scene.extent / np.sin(np.radians(fov_y / 2.0))
    return Camera(tuple((centre + distance * direction).tolist()), tuple(centre.tolist()), fov_y=fov_y)
