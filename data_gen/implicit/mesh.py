"""A triangle mesh as a signed distance on a grid.

Which side a point lies on is voted by rays that count the surfaces they cross, and distances are to those pieces of triangles
that have one side inside and the other outside. So small holes, and shells that reach into each other, do no harm: where a hole
leaves signs and distances at odds, the surface is closed between the nodes.
"""

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.implicit.grid import GridDistance
from prt_bench.progress import track
from prt_bench.scene import Camera, Material, Mesh, Scene

_CANDIDATES = 12  # triangles whose middles are nearest; the nearest of them is the nearest of all unless it is far away
_ASIDE = 0.05  # cells from a triangle to the two points that tell whether it bounds the body
_NODES = 1 << 14
_MARGIN = 3  # cells of free space around the mesh
_MOST = 256
_MOST_CROSSED = 64
_DIRECTIONS = np.array(
    [(0.31, 0.88, 0.35), (-0.72, 0.23, 0.65), (0.54, -0.41, 0.73), (-0.38, -0.84, -0.39), (0.83, 0.17, -0.53)]
)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


def grid_of(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], side: int = 64) -> GridDistance:
    """Distance to a mesh at `side`³ nodes, negative inside. Faces are counter-clockwise from outside.

    Raises `SceneError` for an empty mesh, a side out of range, and a mesh without an inside.
    """
    if not 8 <= side <= _MOST:
        raise SceneError(f"a grid of distances has {side} nodes a side, but needs from 8 to {_MOST}")
    if not len(faces) or not np.all(np.isfinite(vertices)):
        raise SceneError("a mesh without faces, or with vertices that are not finite, has no distance")
    low, high = vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))
    cell = float(np.max(high - low)) / (side - 1 - 2 * _MARGIN)
    corner = (low + high) / 2.0 - 0.5 * cell * (side - 1)
    k, j, i = np.indices((side,) * 3).reshape(3, -1)
    nodes = corner + cell * np.stack([i, j, k], axis=1)
    mesh = Mesh(np.asarray(vertices, float), np.asarray(faces), np.zeros(len(faces), int))
    camera = Camera(tuple(high + 1.0), tuple(low))
    tracer = Tracer(Scene("mesh", mesh, (Material(),), camera))
    inside = _within(tracer, nodes)
    pieces = _boundary(tracer, vertices, faces, cell)
    if not inside.any() or not len(pieces):
        raise SceneError(
            "the mesh has no inside at this resolution; close its holes, turn its faces, or use more nodes"
        )
    distance = _to_triangles(nodes, pieces)
    closed = _closed(distance.reshape((side,) * 3), inside.reshape((side,) * 3), cell)
    return GridDistance(closed.reshape(-1).astype(np.float32), tuple(map(float, corner)), cell)


def _boundary(
    tracer: Tracer, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], cell: float
) -> Float[np.ndarray, "n 3 3"]:
    """Corners of triangles, split until no edge is longer than a cell, that part inside from outside.

    What lies within the body bounds nothing; distances to it would move the surface between the nodes.
    """
    fine, fine_faces = trimesh.remesh.subdivide_to_size(np.asarray(vertices, float), np.asarray(faces), cell, 20)[:2]
    triangles = fine[fine_faces]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(across, axis=1)
    triangles, across = triangles[size > 0], across[size > 0] / size[size > 0, None]
    step = _ASIDE * cell * across
    middle = triangles.mean(axis=1)
    return triangles[_within(tracer, middle - step) & ~_within(tracer, middle + step)]


def _within(tracer: Tracer, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether most of a few rays leave bodies more often than they enter them: inside of at least one shell."""
    votes = np.zeros(len(points), int)
    for direction in _DIRECTIONS:
        at, left, active = np.array(points, float), np.zeros(len(points), int), np.arange(len(points))
        for _ in range(_MOST_CROSSED):
            hits = tracer.intersect(at[active], np.broadcast_to(direction, (len(active), 3)))
            met = np.isfinite(hits.distance)
            active = active[met]
            if not active.size:
                break
            left[active] += np.where(hits.front[met], -1, 1)
            at[active] += (hits.distance[met, None] + tracer.offset) * direction
        votes += left > 0
    return votes > len(_DIRECTIONS) // 2


def _to_triangles(nodes: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, " n"]:
    """Unsigned distance to triangles that are so small that few can be nearest."""
    tree = KDTree(triangles.mean(axis=1))
    found = np.empty(len(nodes))
    count = min(_CANDIDATES, len(triangles))
    for at in track(range(0, len(nodes), _NODES), "distance to a mesh"):
        rows = slice(at, at + _NODES)
        _, candidates = tree.query(nodes[rows], k=count, workers=-1)
        candidates = candidates.reshape(-1, count)
        corners = triangles[candidates].reshape(-1, 3, 3)
        points = np.repeat(nodes[rows], count, axis=0)
        nearest = trimesh.triangles.closest_point(corners, points)
        found[rows] = np.linalg.norm(nearest - points, axis=1).reshape(-1, count).min(axis=1)
    return found


def _closed(distance: Float[np.ndarray, "G G G"], inside: np.ndarray, cell: float) -> Float[np.ndarray, "G G G"]:
    """Signed distances whose size never exceeds a neighbour's of the same side by more than a cell, and half of one where
    neighbours differ in sign."""
    size = distance.copy()
    for axis in range(3):
        one, other = _pairs(axis)
        across = inside[one] != inside[other]
        for half in (one, other):
            size[half] = np.where(across, np.minimum(size[half], cell), size[half])
        open_ = across & (size[one] + size[other] > 1.5 * cell)
        for half in (one, other):
            size[half] = np.where(open_, 0.5 * cell, size[half])
    for _ in range(max(size.shape)):
        before = size.copy()
        for axis in range(3):
            one, other = _pairs(axis)
            size[one] = np.minimum(size[one], size[other] + cell)
            size[other] = np.minimum(size[other], size[one] + cell)
        if np.array_equal(before, size):
            break
    return np.where(inside, -size, size)


def _pairs(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Neighbours along an axis: all nodes but the last, all but the first."""
    one, other = [slice(None)] * 3, [slice(None)] * 3
    one[axis], other[axis] = slice(0, -1), slice(1, None)
    return tuple(one), tuple(other)
