"""Where transfer per vertex is stored: corners of faces that meet smoothly are one vertex, those across a crease are not."""

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from data_gen.atlas import surface_points
from prt_bench.points import SurfacePoints
from prt_bench.scene import Mesh, Scene

CREASE = np.radians(40.0)
"""Greatest angle between the normals of neighbouring faces that share their vertices."""
_INWARD = 1e-3
"""How far, in barycentric coordinates, a vertex is drawn into a face of its own: on an edge, rays start in two planes."""


def shading_vertices(scene: Scene) -> tuple[SurfacePoints, Int[np.ndarray, "F 3"]]:
    """The V vertices with smooth normals (area-weighted over their faces), and the vertex of each face corner."""
    mesh = scene.mesh
    corner = smooth_corners(mesh)
    count = int(corner.max()) + 1
    weighted = np.zeros((count, 3))
    np.add.at(weighted, corner, (mesh.normals * mesh.areas[:, None])[:, None])
    length = np.linalg.norm(weighted, axis=1, keepdims=True)
    order = np.argsort(np.repeat(mesh.areas, 3), kind="stable")  # the largest face of each vertex comes last
    home = np.empty(count, np.int64)
    home[corner.ravel()[order]] = order
    face, place = home // 3, home % 3
    barycentric = np.full((count, 3), _INWARD)
    barycentric[np.arange(count), place] = 1.0 - 2.0 * _INWARD
    points = surface_points(scene, face, barycentric)
    normal = np.where(length > 0, weighted / np.where(length > 0, length, 1.0), points.normal)
    return SurfacePoints(points.position, normal, points.albedo, face, barycentric), corner


def smooth_corners(mesh: Mesh) -> Int[np.ndarray, "F 3"]:
    """A vertex index per face corner: corners at one place are one vertex where their faces are joined over edges without
    a crease. Winding must agree over an edge, so the two sides of a thin surface stay apart."""
    _, place = np.unique(mesh.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    start = place.reshape(-1, 3)
    end = np.roll(start, -1, axis=1)
    ahead = (start * (place.max() + 1) + end).ravel()
    back = (end * (place.max() + 1) + start).ravel()
    _, key = np.unique(np.concatenate([ahead, back]), return_inverse=True)
    edges, size = np.arange(len(ahead)), int(key.max()) + 1
    owns = coo_array((np.ones(len(ahead), bool), (edges, key[: len(ahead)])), (len(ahead), size)).tocsr()
    meets = coo_array((np.ones(len(ahead), bool), (edges, key[len(ahead) :])), (len(ahead), size)).tocsr()
    first, second = (owns @ meets.T).nonzero()
    smooth = np.sum(mesh.normals[first // 3] * mesh.normals[second // 3], axis=1) >= np.cos(CREASE)
    first, second = first[smooth], second[smooth]
    # Edge i of a face runs from corner i to i + 1, and its neighbour's the other way.
    joined = np.concatenate([np.stack([first, _next(second)]), np.stack([_next(first), second])], axis=1)
    graph = coo_array((np.ones(joined.shape[1], bool), tuple(joined)), (len(ahead), len(ahead)))
    return connected_components(graph, directed=False)[1].reshape(-1, 3)


def _next(corner: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The next corner of the same face."""
    return corner - corner % 3 + (corner + 1) % 3
