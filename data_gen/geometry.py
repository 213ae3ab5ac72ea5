"""Triangle meshes: building them from parts, repairing, refining and coarsening them, and giving them a second side.

Texture atlases live in `atlas.py`, point sets in `sampling.py`, reading files in `loader.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from prt_bench.errors import SceneError
from prt_bench.scene import Material, Mesh

DEGENERATE_ASPECT = 1e-10
"""A triangle is degenerate when twice its area is below this fraction of its longest edge squared."""
SIDE_GAP = 2.0**-16
"""Distance between the two sides of a sheet, relative to the extent: above float32 rounding, below ray offsets."""
_SPLIT_TOGETHER = (
    0.8  # edges down to this share of the longest are halved in one round: small triangles stay well-shaped
)
_LLOYD_ROUNDS = 12
_STAY = 0.02  # weight of a cluster's mean against the planes of its vertices


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


def solid(mesh: trimesh.Trimesh, material: int) -> Part:
    """A body that trimesh made, front where its faces run counter-clockwise."""
    return Part(np.array(mesh.vertices, float), np.array(mesh.faces), material)


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


def subdivided(mesh: Mesh, longest: float) -> Mesh:
    """The same surface in smaller triangles: edges longer than `longest` (metres) are halved, the longest first.

    Whether an edge is halved in a round depends on its ends alone, so triangles that meet in an edge, or in two edges at
    the same place, halve it alike: no T-junction arises. Materials and texture coordinates are kept, and shared vertices
    stay shared. Raises `SceneError` for a length that is not above zero.
    """
    if not longest > 0:
        raise SceneError(f"edges of at most {longest} m were asked for; subdivision needs a length above zero")
    vertices, faces, material, uv = mesh.vertices, mesh.faces, mesh.material, mesh.uv
    while True:
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)  # edge i runs from corner i
        edges, index = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
        squared = np.sum((vertices[edges[:, 0]] - vertices[edges[:, 1]]) ** 2, axis=1)
        split = squared > max(longest**2, _SPLIT_TOGETHER**2 * squared.max())
        if not split.any():
            return Mesh(vertices, faces, material, uv)
        middle = np.full(len(edges), -1)
        middle[split] = len(vertices) + np.arange(split.sum())
        vertices = np.concatenate([vertices, 0.5 * (vertices[edges[split, 0]] + vertices[edges[split, 1]])])
        corners, parent, places = _split_faces(faces, middle[index.reshape(-1, 3)], vertices)
        faces, material = corners, material[parent]
        if uv is not None:
            both = np.concatenate([uv, 0.5 * (uv + np.roll(uv, -1, axis=1))], axis=1)[parent]
            uv = np.take_along_axis(both, places[..., None], axis=1)


def _split_faces(
    faces: Int[np.ndarray, "F 3"], middle: Int[np.ndarray, "F 3"], vertices: Float[np.ndarray, "V 3"]
) -> tuple[Int[np.ndarray, "G 3"], Int[np.ndarray, " G"], Int[np.ndarray, "G 3"]]:
    """Faces cut at the middles of some edges (−1: whole): new faces, the face each is of, and which of its six places
    (corners, then middles) each corner is."""
    count = np.sum(middle >= 0, axis=1)
    # Turn each face so that one cut edge is edge 0, and two are edges 0 and 1.
    turn = np.where(count == 1, np.argmax(middle >= 0, axis=1), (np.argmax(middle < 0, axis=1) + 1) % 3)
    order = (turn[:, None] + np.arange(3)) % 3
    six = np.concatenate([np.take_along_axis(faces, order, 1), np.take_along_axis(middle, order, 1)], axis=1)
    places = np.concatenate([order, order + 3], axis=1)
    # Beside the corner cut off, two cut edges leave a quadrilateral 0-3-4-2, which its shorter diagonal halves.
    cross = count == 2
    ends = vertices[six[cross]]
    shorter = np.zeros(len(faces), bool)
    shorter[cross] = np.sum((ends[:, 0] - ends[:, 4]) ** 2, 1) < np.sum((ends[:, 2] - ends[:, 3]) ** 2, 1)
    cases = [
        (count == 0, [(0, 1, 2)]),
        (count == 1, [(0, 3, 2), (3, 1, 2)]),
        (cross & shorter, [(3, 1, 4), (0, 3, 4), (0, 4, 2)]),
        (cross & ~shorter, [(3, 1, 4), (0, 3, 2), (3, 4, 2)]),
        (count == 3, [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)]),
    ]
    rows = np.concatenate([np.repeat(np.flatnonzero(chosen), len(pattern)) for chosen, pattern in cases])
    picks = np.concatenate([np.tile(pattern, (chosen.sum(), 1)) for chosen, pattern in cases])
    by_parent = np.argsort(rows, kind="stable")
    rows, picks = rows[by_parent], picks[by_parent]
    return np.take_along_axis(six[rows], picks, 1), rows, np.take_along_axis(places[rows], picks, 1)


def clustered(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int, seed: int = 0
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "G 3"]]:
    """A coarser surface of about `count` vertices: connected clusters of vertices, each drawn together to one point.

    Clusters are the Voronoi cells of a few rounds of Lloyd's algorithm over positions and normals, so that the two sides
    of an ear stay apart; a cell in several pieces becomes several clusters. The point is nearest to the planes of the
    cluster's vertices, which keeps volume and ridges. A face remains where it spans three clusters; faces that cover each
    other from both sides cancel. (Valette and Chassery 2004, "Approximated Centroidal Voronoi Diagrams for Uniform
    Polygonal Mesh Coarsening"; planes: Lindstrom 2000, "Out-of-Core Simplification of Large Polygonal Models".)
    """
    mesh = Mesh(vertices, faces, np.zeros(len(faces), int))
    weight, normal = np.zeros(len(vertices)), np.zeros((len(vertices), 3))
    for corner in faces.T:
        np.add.at(weight, corner, mesh.areas / 3.0)
        np.add.at(normal, corner, mesh.areas[:, None] * mesh.normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    spacing = np.sqrt(mesh.areas.sum() / count)
    place = np.concatenate([vertices, spacing * normal], axis=1)
    centre = place[np.random.default_rng(seed).choice(len(place), count, replace=False, p=weight / weight.sum())]
    for _ in range(_LLOYD_ROUNDS):
        nearest = np.asarray(KDTree(centre).query(place)[1])
        centre = _means(place, weight, nearest, count)
    ends = np.concatenate([faces, np.roll(faces, -1, axis=1)]).reshape(2, -1)
    inside = ends[:, nearest[ends[0]] == nearest[ends[1]]]
    graph = coo_array((np.ones(inside.shape[1], bool), tuple(inside)), shape=(len(vertices),) * 2)
    cluster = np.asarray(connected_components(graph, directed=False)[1])
    pieces = int(cluster.max()) + 1
    corners = _without_doubles(cluster[faces])
    # Σ (n·(x − p))² + ε |x − mean|², about the mean.
    mean = _means(vertices, weight, cluster, pieces)
    planes = np.concatenate([normal, np.sum(normal * (vertices - mean[cluster]), axis=1)[:, None]], axis=1)
    sums = _means((normal[:, :, None] * planes[:, None]).reshape(-1, 12), weight, cluster, pieces).reshape(-1, 3, 4)
    shift = np.linalg.solve(sums[..., :3] + _STAY * np.eye(3), sums[..., 3:])[..., 0]
    used, kept = np.unique(corners, return_inverse=True)
    return (mean + shift)[used], kept.reshape(-1, 3)


def _means(values: np.ndarray, weight: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """Weighted mean of the values of each owner."""
    total = np.maximum(np.bincount(owner, weight, count), np.finfo(float).tiny)
    return np.stack([np.bincount(owner, weight * column, count) for column in values.T], axis=1) / total[:, None]


def _without_doubles(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "G 3"]:
    """Each face of three corners once, and none where as many run the other way round."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    lead = np.argmin(faces, axis=1)
    ordered = np.take_along_axis(faces, (lead[:, None] + np.arange(3)) % 3, axis=1)
    way = np.where(ordered[:, 1] < ordered[:, 2], 1, -1)
    sets, owner = np.unique(np.sort(ordered, axis=1), axis=0, return_inverse=True)
    balance = np.bincount(owner.reshape(-1), way, len(sets))
    return np.concatenate([sets[balance > 0], sets[balance < 0][:, [0, 2, 1]]])


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
