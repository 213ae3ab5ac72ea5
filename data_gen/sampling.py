"""Blue-noise points on surfaces: where direct light is measured at run time.

Weighted sample elimination: Yuksel 2015, "Sample Elimination for Generating Poisson Disk Sample Sets", Computer
Graphics Forum 34(2).
"""

import heapq

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from data_gen.atlas import surface_points
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.points import SurfacePoints
from prt_bench.scene import Scene

CANDIDATES = 5
"""Random points per point that remains."""
CLOSEST_SPACING = 1.0 / 200.0
"""Points nearer to each other than this fraction of the extent would measure the same light."""
_ALPHA, _BETA, _GAMMA = 8, 0.65, 1.5  # the paper's constants
_SAME_WAY = 0.5  # cosine between normals from which two surfaces face the same way
_NEIGHBOURS = 4  # candidates per wanted member of a group
_LIFT = 0.2  # height of a line of sight above the surface, relative to its length


def poisson_radius(area: float, count: int) -> float:
    """Largest radius, half the spacing, at which `count` disks pack an area: sqrt(area / (2 √3 count))."""
    return float(np.sqrt(area / (2.0 * np.sqrt(3.0) * count)))


def sample_elimination(points: Float[np.ndarray, "P 3"], target: int, area: float) -> Int[np.ndarray, " target"]:
    """Ascending indices of the `target` points that remain when the most crowded one is removed again and again.

    `area` is that of the sampled surface in m². A point's crowding is Σ (1 − d / 2 r_max)⁸ over neighbours at distance
    d < 2 r_max, where distances under 2 r_min count as 2 r_min (weight limiting). Deterministic.
    """
    count = len(points)
    radius = poisson_radius(area, target)
    least = radius * (1.0 - (target / count) ** _GAMMA) * _BETA
    pairs = KDTree(points).query_pairs(2.0 * radius, output_type="ndarray")
    distance = np.maximum(np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1), 2.0 * least)
    weight = (1.0 - np.minimum(distance / (2.0 * radius), 1.0)) ** _ALPHA

    # Adjacency in compressed rows, as lists: the loop below is scalar work.
    source, target_of, weights = np.r_[pairs[:, 0], pairs[:, 1]], np.r_[pairs[:, 1], pairs[:, 0]], np.r_[weight, weight]
    order = np.argsort(source, kind="stable")
    start = np.searchsorted(source[order], np.arange(count + 1)).tolist()
    neighbour, share = target_of[order].tolist(), weights[order].tolist()
    crowding = np.bincount(source, weights, minlength=count).tolist()

    heap = [(-value, index) for index, value in enumerate(crowding)]
    heapq.heapify(heap)
    alive = [True] * count
    for _ in range(count - target):
        value, index = heapq.heappop(heap)
        while not alive[index] or -value != crowding[index]:  # an entry from before its crowding changed
            value, index = heapq.heappop(heap)
        alive[index] = False
        for at in range(start[index], start[index + 1]):
            other = neighbour[at]
            if alive[other]:
                crowding[other] -= share[at]
                heapq.heappush(heap, (-crowding[other], other))
    return np.flatnonzero(alive)


def random_points(scene: Scene, count: int, seed: int | np.random.SeedSequence = 0) -> SurfacePoints:
    """Points uniform in area, stratified over the faces' cumulative area."""
    random = np.random.default_rng(seed)
    cumulative = np.cumsum(scene.mesh.areas)
    position = (np.arange(count) + random.random(count)) / count * cumulative[-1]
    face = np.minimum(np.searchsorted(cumulative, position, side="right"), len(cumulative) - 1)
    root, along = np.sqrt(random.random(count)), random.random(count)
    barycentric = np.stack([1.0 - root, root * (1.0 - along), root * along], axis=1)
    return surface_points(scene, face, barycentric)


def measurement_points(
    scene: Scene, count: int, supersampling: int = 8, seed: int = 0, tracer: Tracer | None = None
) -> tuple[SurfacePoints, SurfacePoints, Int[np.ndarray, "M s"]]:
    """Points where direct light is measured, and the denser points over which each measurement is averaged.

    Returns `count` blue-noise points, `count · supersampling` denser ones, and for each of the former the indices of
    its `supersampling` nearest dense points: on a surface that faces the same way and within sight, so that no group
    reaches through a wall. Points buried in solid geometry are not used. With `supersampling` 1 each point is its own
    group. Raises `SceneError` for more points than the surface can hold.
    """
    check_measurements(scene, count, supersampling)
    tracer = tracer or Tracer(scene)
    coarse_seed, dense_seed = np.random.SeedSequence(seed).spawn(2)
    points = _blue_noise(scene, count, coarse_seed, tracer)
    if supersampling == 1:
        return points, points, np.arange(count)[:, None]
    dense = _blue_noise(scene, count * supersampling, dense_seed, tracer)
    return points, dense, _groups(points, dense, supersampling, tracer)


def on_pose(scene: Scene, points: SurfacePoints) -> SurfacePoints:
    """The same places on the surface, face and barycentrics, on another pose of the mesh."""
    return surface_points(scene, points.face, points.barycentric)


def check_measurements(scene: Scene, count: int, supersampling: int) -> None:
    """Raise `SceneError` for more measurement points than the surface can hold, or for none."""
    if count < 1 or supersampling < 1:
        raise SceneError(f"{count} measurement points with supersampling {supersampling}: both must be at least 1")
    area = float(scene.mesh.areas.sum())
    if 2.0 * poisson_radius(area, count) < CLOSEST_SPACING * scene.extent:
        most = int(area / (2.0 * np.sqrt(3.0) * (0.5 * CLOSEST_SPACING * scene.extent) ** 2))
        raise SceneError(
            f"{count} measurement points do not fit on scene '{scene.name}': its {area:.3g} m² of surface hold at most"
            f" {most}, so ask for fewer"
        )


def _blue_noise(scene: Scene, count: int, seed: np.random.SeedSequence, tracer: Tracer) -> SurfacePoints:
    candidates = random_points(scene, CANDIDATES * count, seed)
    exposed = ~tracer.inside(candidates.position + tracer.offset * candidates.normal)
    if np.sum(exposed) < count:  # all but everything is buried: buried points are better than none
        exposed[:] = True
    area = float(scene.mesh.areas.sum() * np.mean(exposed))
    candidates = candidates[exposed]
    return candidates[sample_elimination(candidates.position, count, area)]


def _groups(points: SurfacePoints, dense: SurfacePoints, size: int, tracer: Tracer) -> Int[np.ndarray, "M s"]:
    """Indices of the `size` nearest eligible dense points; where fewer are eligible, those repeat."""
    _, near = KDTree(dense.position).query(points.position, k=min(_NEIGHBOURS * size, len(dense)))
    facing = np.einsum("mkd,md->mk", dense.normal[near], points.normal) > _SAME_WAY
    # On a convex surface the straight line between two points lies below it: look from a little above instead.
    apart = dense.position[near] - points.position[:, None]
    height = tracer.offset + _LIFT * np.linalg.norm(apart, axis=-1, keepdims=True)
    lifted = points.position[:, None] + height * points.normal[:, None]
    segment = dense.position[near] + height * dense.normal[near] - lifted
    hidden = tracer.occluded(lifted.reshape(-1, 3), segment.reshape(-1, 3)).reshape(near.shape)
    eligible = facing & ~hidden
    # Eligible neighbours first, each kind from near to far; the k-th member wraps round a short list.
    order = np.argsort(~eligible, axis=1, kind="stable")
    held = np.maximum(eligible.sum(axis=1), 1)
    member = np.arange(size)[None, :] % held[:, None]
    return np.take_along_axis(near, np.take_along_axis(order, member, axis=1), axis=1)
