"""Triangle meshes: building them from parts, checking and repairing them, and giving them a second side.

Texture atlases live in `atlas.py`, point sets in `sampling.py`, reading files in `loader.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SceneError
from prt_bench.scene import Material, Mesh

DEGENERATE_ASPECT = 1e-10
"""A triangle is degenerate when twice its area is below this fraction of its longest edge squared."""
SIDE_GAP = 2.0**-16
"""Distance between the two sides of a sheet, relative to the extent: above float32 rounding, below ray offsets."""


@dataclass(frozen=True)
class Part:
    """Triangles of one material, a piece from which `assemble` makes a mesh."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    material: int
    uv: Float[np.ndarray, "F 3 2"] | None = None

    def transformed(
        self, matrix: Float[np.ndarray, "3 3"], offset: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    ) -> "Part":
        """Vertices multiplied by `matrix`, then moved by `offset`."""
        return replace(self, vertices=self.vertices @ np.asarray(matrix, float).T + np.asarray(offset, float))


def quad(corners: Sequence[Sequence[float]], material: int) -> Part:
    """Planar quadrilateral, front where its four corners run counter-clockwise."""
    return Part(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]), material)


def box(half_extents: Sequence[float], material: int) -> Part:
    """Closed axis-aligned box about the origin, normals outward."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Part(signs * np.asarray(half_extents, float), np.array(faces), material)


def rotation_about(axis: int, degrees: float) -> Float[np.ndarray, "3 3"]:
    """Right-handed rotation about coordinate axis 0, 1 or 2."""
    angle = np.radians(degrees)
    following, last = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[following, following] = matrix[last, last] = np.cos(angle)
    matrix[last, following], matrix[following, last] = np.sin(angle), -np.sin(angle)
    return matrix


def assemble(parts: Sequence[Part]) -> Mesh:
    """One mesh of all parts, in order. Texture coordinates are kept when every part has them."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    uvs = [part.uv for part in parts if part.uv is not None]
    return Mesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=False)]),
        material=np.concatenate([np.full(len(part.faces), part.material) for part in parts]),
        uv=np.concatenate(uvs) if len(uvs) == len(parts) else None,
    )


def repair(mesh: Mesh, name: str) -> tuple[Mesh, tuple[str, ...]]:
    """Drop degenerate triangles, and say how many; every other defect is refused, nothing is merged.

    `name` is what the messages call the mesh. Raises `SceneError` for a mesh without faces, with vertices that are not
    finite, with faces that name missing vertices, or without extent.
    """
    if len(mesh.faces) == 0:
        raise SceneError(f"{name} has no triangles; a scene needs a surface to light")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise SceneError(f"{name} has faces that name vertices outside 0 to {len(mesh.vertices) - 1}; repair the file")
    bad = int(np.sum(~np.isfinite(mesh.vertices).all(axis=1)))
    if bad:
        raise SceneError(f"{name} has {bad} vertices that are not finite numbers; repair the file")
    used = mesh.vertices[np.unique(mesh.faces)]
    if not np.ptp(used, axis=0).max() > 0:
        raise SceneError(
            f"{name} has zero extent: all its vertices coincide (a Draco-compressed glTF reads so without its decoder:"
            " pip install 'prt-bench[draco]', or export it uncompressed)"
        )
    edges = mesh.triangles - np.roll(mesh.triangles, 1, axis=1)
    longest = np.einsum("fed,fed->fe", edges, edges).max(axis=1)
    sound = 2.0 * mesh.areas > DEGENERATE_ASPECT * longest
    dropped = int(np.sum(~sound))
    if dropped == 0:
        return mesh, ()
    if not sound.any():
        raise SceneError(f"{name} has zero area: all of its {dropped} triangles are degenerate")
    kept = Mesh(mesh.vertices, mesh.faces[sound], mesh.material[sound], None if mesh.uv is None else mesh.uv[sound])
    return kept, (f"dropped {dropped} degenerate triangle{'s' * (dropped > 1)} of {len(mesh.faces)}",)


def is_closed(part: Part) -> bool:
    """Whether the part encloses a volume: every edge belongs to two faces that run along it opposite ways."""
    _, position = np.unique(part.vertices, axis=0, return_inverse=True)
    corner = position.reshape(-1)[part.faces]
    edges = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    forward, count = np.unique(edges, axis=0, return_counts=True)
    backward = np.unique(edges[:, ::-1], axis=0)
    return bool(np.all(count == 1)) and np.array_equal(forward, backward)


def with_both_sides(mesh: Mesh, materials: Sequence[Material]) -> Mesh:
    """Give every face of a two-sided material a copy with reversed winding, so that both sides get texels.

    The reverse, added or found in the mesh, is moved along its normal by `SIDE_GAP` of the extent: a ray then meets the
    side that faces it first, where coincident faces would leave the choice to rounding.
    """
    two_sided = np.array([material.two_sided for material in materials])[mesh.material]
    wanted = np.flatnonzero(two_sided & (_reverse_of(mesh) < 0))
    doubled = Mesh(
        vertices=mesh.vertices,
        faces=np.concatenate([mesh.faces, mesh.faces[wanted][:, ::-1]]),
        material=np.concatenate([mesh.material, mesh.material[wanted]]),
        uv=None if mesh.uv is None else np.concatenate([mesh.uv, mesh.uv[wanted][:, ::-1]]),
    )
    reverse = _reverse_of(doubled)
    behind = np.flatnonzero((reverse >= 0) & (reverse < np.arange(len(reverse))))
    used, corner = np.unique(doubled.faces[behind], return_inverse=True)
    corner = corner.reshape(-1, 3)
    normal = np.zeros((len(used), 3))
    np.add.at(normal, corner, doubled.normals[behind][:, None])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    gap = SIDE_GAP * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    faces = doubled.faces.copy()
    faces[behind] = corner + len(mesh.vertices)
    return replace(doubled, vertices=np.concatenate([mesh.vertices, mesh.vertices[used] + gap * normal]), faces=faces)


def _reverse_of(mesh: Mesh) -> Int[np.ndarray, " F"]:
    """For each face, the first face that covers the same triangle seen from behind, or −1."""
    _, position = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = position.reshape(-1)[mesh.faces]
    # Rotate each face so that its lowest corner leads: the winding is then the order of the other two.
    lead = np.argmin(corners, axis=1)
    ordered = np.take_along_axis(corners, (lead[:, None] + np.arange(3)) % 3, axis=1)
    _, key = np.unique(np.concatenate([ordered, ordered[:, [0, 2, 1]]]), axis=0, return_inverse=True)
    own, wanted = np.split(key.reshape(-1), 2)
    keys, first = np.unique(own, return_index=True)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, first[at], -1)
