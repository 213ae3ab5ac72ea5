"""Samples of surfaces without a mesh of their own: particles fly through a scene, and where they land is thinned.

Needs no lightmap, and finds only surface that light from inside the scene can reach. What rays between such samples meet lives
in `meshless.py`, their clusters in `prt_bench/clusters.py`.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from data_gen.atlas import surface_points
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.points import SurfacePoints
from prt_bench.scene import Scene

FIRST = 5
"""Reflections before a particle's hits count: by then it has forgotten where it started."""
_LAST = 60
_FEWEST = 256  # particles at a time
_WAVES = 16
_CANDIDATES = 12  # hits that are looked for in place of each sample
_JAMMED = 0.547
"""Share of a plane that disks cover when they are thrown at random until none fits (Feder 1980)."""
_NEIGHBOURS = 8
_SAME_WAY = 0.5  # cosine between normals from which two samples are of one surface
_MOST_BENT = 3.0  # by which the radius is divided at most


def particle_samples(
    scene: Scene, tracer: Tracer, start: Float[np.ndarray, "3"], radius: float, seed: int = 0
) -> SurfacePoints:
    """Samples no closer than `radius` in m where a surface is flat, closer where it is curved; deterministic.

    Particles leave `start`, a place in free space, in all directions and are reflected diffusely; from the fifth reflection on
    every hit is a candidate. In a closed scene they are uniform in area. A particle that escapes or meets a back ends. Raises
    `SceneError` where next to none comes that far.
    """
    wanted = int(_CANDIDATES * _JAMMED * scene.mesh.areas.sum() / (0.25 * np.pi * radius**2))
    particles = max(wanted // (_LAST - FIRST), _FEWEST)
    rng = np.random.default_rng([seed, 17])
    faces, corners, found = [], [], 0
    for _ in range(_WAVES):
        for face, barycentric in _wave(scene, tracer, np.asarray(start, float), particles, rng):
            faces.append(face)
            corners.append(barycentric)
            found += len(face)
        if found >= wanted:
            break
    else:
        raise SceneError(
            f"scene '{scene.name}': of {_WAVES * particles} particles from ({', '.join(f'{x:.3g}' for x in start)}) only"
            f" {found} hits came after {FIRST} reflections where {wanted} are needed; start elsewhere or take a larger radius"
        )
    order = rng.permutation(found)  # hits came sorted by reflection, and late ones have gone farther
    points = surface_points(scene, np.concatenate(faces)[order], np.concatenate(corners)[order])
    return points[thinned(points, radius / (1.0 + np.minimum(radius * curvature(points), _MOST_BENT - 1.0)))]


def _wave(
    scene: Scene, tracer: Tracer, start: np.ndarray, particles: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Face and barycentric coordinates of what particles of one wave hit from the fifth reflection on."""
    direction = rng.normal(size=(particles, 3))
    origin = np.broadcast_to(start, direction.shape)
    kept = []
    for reflection in range(_LAST):
        hits = tracer.intersect(origin, direction)
        alive = np.flatnonzero(hits.front & (hits.face >= 0))
        face, u, v = hits.face[alive], hits.u[alive].astype(float), hits.v[alive].astype(float)
        barycentric = np.stack([1.0 - u - v, u, v], axis=1)
        if reflection >= FIRST:
            kept.append((face, barycentric))
        normal = scene.mesh.normals[face]
        place = np.einsum("pc,pcd->pd", barycentric, scene.mesh.triangles[face])
        # A point of the unit sphere about the tip of the normal: cosine-weighted.
        sphere = rng.normal(size=(len(alive), 3))
        direction = normal + 0.999 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
        origin = place + tracer.offset * normal
    return kept


def curvature(points: SurfacePoints) -> Float[np.ndarray, " P"]:
    """How fast the normal turns about each point, in 1/m: the median of |Δn| / |Δp| over neighbours that face the same way.

    Edges between flat faces count for nothing: whoever stands behind one faces another way, or the same way exactly.
    """
    distance, near = KDTree(points.position).query(points.position, k=_NEIGHBOURS + 1, workers=-1)
    turned = np.linalg.norm(points.normal[near] - points.normal[:, None], axis=-1)
    same = (np.einsum("pkd,pd->pk", points.normal[near], points.normal) > _SAME_WAY) & (distance > 0)
    rate = np.where(same, turned / np.where(distance > 0, distance, 1.0), 0.0)
    return np.median(rate[:, 1:], axis=1)


def thinned(points: SurfacePoints, radius: Float[np.ndarray, " P"]) -> Int[np.ndarray, " n"]:
    """Ascending indices of points that stay when each, in its order, removes those after it within its own radius in m.

    Only points that face the same way are removed, so that neither side of a thin wall thins the other.
    """
    tree = KDTree(points.position)
    alive = np.ones(len(points), bool)
    for index in range(len(points)):
        if alive[index]:
            near = np.array(tree.query_ball_point(points.position[index], radius[index]))
            near = near[(near > index) & (points.normal[near] @ points.normal[index] > _SAME_WAY)]
            alive[near] = False
    return np.flatnonzero(alive)
