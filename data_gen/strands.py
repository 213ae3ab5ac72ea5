"""Hair on a scene: strands that grow out of a surface, by a seed, and the scene with their tubes in its mesh."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SceneError
from prt_bench.hemisphere import tangent_frames
from prt_bench.scene import Mesh, Scene
from prt_bench.strands import Strands


@dataclass(frozen=True)
class Growth:
    """How strands grow: `length` and `radius` of the fibre in metres, and `segments` of each strand.

    `spread` is how far, in radians, they lean off the surface's normal on average, `fall` by how much they have turned down
    (towards −y) at their tips, in radians, `curl` by how much their direction wanders on the way. `vary` is the standard
    deviation of their lengths, relative to `length`.
    """

    length: float
    radius: float
    segments: int = 5
    spread: float = 0.2
    fall: float = 0.5
    curl: float = 0.15
    vary: float = 0.1

    def __post_init__(self) -> None:
        for name in ("length", "radius"):
            if not 0 < getattr(self, name) < np.inf:
                raise SceneError(f"hair grows with {name} {getattr(self, name)}, but it must be above zero metres")
        if self.segments < 1:
            raise SceneError(f"hair grows in {self.segments} segments, but a strand has at least one")
        for name in ("spread", "fall", "curl", "vary"):
            if not 0 <= getattr(self, name) <= np.pi:
                raise SceneError(f"hair grows with {name} {getattr(self, name)}, but it must lie from 0 to π")


def grow(scene: Scene, on: int, material: int, count: int, growth: Growth, seed: int = 0) -> Scene:
    """The scene with `count` strands of hair of a `material` on the faces of the material `on`, even in area.

    Raises `SceneError` where there are no such faces, or nothing is to grow.
    """
    faces = np.flatnonzero(scene.mesh.material[: scene.surfaces] == on)
    if not faces.size:
        raise SceneError(f"scene '{scene.name}' has no faces of material {on} for hair to grow on")
    if count < 1:
        raise SceneError(f"{count} strands of hair were asked for; grow at least one")
    if seed < 0:
        raise SceneError(f"hair grows by the seed {seed}, but a seed must not be negative")
    random = np.random.default_rng(seed)
    cumulative = np.cumsum(scene.mesh.areas[faces])
    chosen = np.searchsorted(cumulative, (np.arange(count) + random.random(count)) / count * cumulative[-1])
    face = faces[np.minimum(chosen, len(faces) - 1)]
    inward, along = np.sqrt(random.random(count)), random.random(count)
    barycentric = np.stack([1.0 - inward, inward * (1.0 - along), inward * along], axis=1)
    root = np.einsum("pc,pcd->pd", barycentric, scene.mesh.triangles[face])
    normal = _smooth_normals(scene, face, barycentric)
    nodes = _shaped(root, normal, growth, random)
    starts = np.arange(count + 1) * (growth.segments + 1)
    return with_strands(scene, Strands(nodes, starts, np.full(count, growth.radius), np.full(count, material)))


def strands_of(curves: list[Float[np.ndarray, "k 3"]], radius: float, material: int) -> tuple[Strands, tuple[str, ...]]:
    """Strands from polylines, root first; segments without length are left out, and strands of nothing else, and notes say so.

    Raises `SceneError` where nothing is left.
    """
    kept = []
    for curve in curves:
        nodes = np.asarray(curve, float).reshape(-1, 3)
        moved = np.ones(len(nodes), bool)
        moved[1:] = np.any(np.diff(nodes, axis=0) != 0, axis=1)
        if moved.sum() > 1:
            kept.append(nodes[moved])
    lost = len(curves) - len(kept)
    starts = np.cumsum([0] + [len(nodes) for nodes in kept])
    nodes = np.concatenate(kept) if kept else np.zeros((0, 3))
    strands = Strands(nodes, starts, np.full(len(kept), radius), np.full(len(kept), material))
    return strands, (f"dropped {lost} strand{'s' * (lost > 1)} without length of {len(curves)}",) if lost else ()


def with_strands(scene: Scene, strands: Strands) -> Scene:
    """The scene with `strands` besides those it has, their tubes after all other faces.

    Raises `SceneError` for a material that is not hair.
    """
    for index in np.unique(strands.material):
        if not 0 <= index < len(scene.materials) or scene.materials[index].hair is None:
            raise SceneError(
                f"strands of scene '{scene.name}' have material {index}, which is not hair; give it fibres"
            )
    bare = without_strands(scene)
    if scene.strands is not None:
        old = scene.strands
        strands = Strands(
            np.concatenate([old.nodes, strands.nodes]),
            np.concatenate([old.starts, strands.starts[1:] + old.starts[-1]]),
            np.concatenate([old.radius, strands.radius]),
            np.concatenate([old.material, strands.material]),
        )
    mesh = bare.mesh
    owner = strands.owner[strands.corners[0][:, 0]]
    uv = mesh.uv
    if uv is not None:
        uv = np.concatenate([uv, np.zeros((len(strands.faces), 3, 2))])
    tubes = Mesh(
        np.concatenate([mesh.vertices, strands.vertices]),
        np.concatenate([mesh.faces, strands.faces + len(mesh.vertices)]),
        np.concatenate([mesh.material, strands.material[owner]]),
        uv,
    )
    return replace(scene, mesh=tubes, strands=strands)


def without_strands(scene: Scene) -> Scene:
    """The scene's surfaces alone; itself where it has no hair."""
    if scene.strands is None:
        return scene
    mesh, count = scene.mesh, scene.surfaces
    vertices = len(mesh.vertices) - len(scene.strands.vertices)
    uv = None if mesh.uv is None else mesh.uv[:count]
    return replace(
        scene, mesh=Mesh(mesh.vertices[:vertices], mesh.faces[:count], mesh.material[:count], uv), strands=None
    )


def _smooth_normals(
    scene: Scene, face: Int[np.ndarray, " p"], barycentric: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Normals interpolated between the means at vertices: strands of a coarse mesh do not part along its edges."""
    mesh = scene.mesh
    place, corner = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corner = corner.reshape(-1)[mesh.faces]
    mean = np.zeros_like(place)
    np.add.at(mean, corner, (mesh.normals * mesh.areas[:, None])[:, None])
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(float).tiny)
    normal = np.einsum("pc,pcd->pd", barycentric, mean[corner[face]])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 0.1, normal / np.maximum(length, 0.1), mesh.normals[face])


def _shaped(
    root: Float[np.ndarray, "p 3"], normal: Float[np.ndarray, "p 3"], growth: Growth, random: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Nodes of strands that leave `root` about `normal`."""
    count, segments = len(root), growth.segments
    lean = np.abs(random.normal(0.0, growth.spread, count))
    frames = tangent_frames(normal, random.uniform(0.0, 2.0 * np.pi, count))
    direction = np.cos(lean)[:, None] * normal + np.sin(lean)[:, None] * frames[:, 0]
    length = growth.length * np.maximum(1.0 + growth.vary * random.normal(size=count), 0.2)
    nodes = [root]
    for _ in range(segments):
        turn = random.normal(0.0, growth.curl / np.sqrt(segments), (count, 3))
        direction = direction + turn + (0.0, -growth.fall / segments, 0.0)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        nodes.append(nodes[-1] + (length / segments)[:, None] * direction)
    return np.stack(nodes, axis=1).reshape(-1, 3)
