"""Clusters of surface points: roots that are spread evenly over a surface, the root that every point belongs to, and bases.

Nearness is that of place and normal together, so that a cluster reaches neither through a thin wall nor round a corner; on the
floor it reaches from room to room, unless what stands between counts as well. What is stored for clusters lives in
`clustered.py` and `sampled.py`; particles that find points without a lightmap are in `data_gen/particles.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from prt_bench.errors import FitError
from prt_bench.linalg import principal_rows
from prt_bench.points import SurfacePoints


class Clusters(NamedTuple):
    """P roots in feature space [P, 6], position in m and normal times `bend`; every point is within `radius` of one of them.

    `chosen` [P] are the points that became roots.
    """

    roots: Float[np.ndarray, "P 6"]
    bend: float
    radius: float
    chosen: Int[np.ndarray, " P"]

    def __len__(self) -> int:
        return len(self.roots)

    def owner(self, points: SurfacePoints) -> Int[np.ndarray, " p"]:
        """The cluster of each of some points, whichever they are: the one with the nearest root."""
        return np.asarray(KDTree(self.roots).query(_features(points, self.bend))[1])


def clusters_of(points: SurfacePoints, count: int, bend: float, radius: float = 0.0) -> Clusters:
    """Up to `count` roots among the points, fewer where all points are within `radius`, in m, of one sooner.

    Each root is the point that is farthest from those before it (Gonzalez 1985, "Clustering to minimize the maximum
    intercluster distance"), so no two are closer than the radius that is left: what thinning by that radius keeps. The first
    is nearest to the middle. `bend` in m is the distance that normals at right angles count for, over √2. Deterministic.
    Raises `FitError` where there is no point.
    """
    return _grown(points, count, bend, radius, None)[0]


def clusters_in_sight(
    points: SurfacePoints, count: int, bend: float, hidden: Callable[[int], Bool[np.ndarray, " p"]]
) -> tuple[Clusters, Int[np.ndarray, " p"]]:
    """Clusters whose members mostly see their root, and the cluster of each point: walls part what lies on both of their sides.

    `hidden` tells which points do not see that of an index; for those it is `bend` farther away than it is. Otherwise as
    `clusters_of`, and `radius` is a distance with that added.
    """
    return _grown(points, count, bend, 0.0, hidden)


def _grown(
    points: SurfacePoints,
    count: int,
    bend: float,
    radius: float,
    hidden: Callable[[int], Bool[np.ndarray, " p"]] | None,
) -> tuple[Clusters, Int[np.ndarray, " p"]]:
    """Roots one after another, and the nearest of them to each point."""
    if not len(points):
        raise FitError("there are no points to form clusters of; give at least one receiver")
    features = _features(points, bend)

    def from_(root: int) -> Float[np.ndarray, " p"]:
        away = np.linalg.norm(features - features[root], axis=1)
        return away if hidden is None else away + bend * hidden(root)

    middle = np.linalg.norm(features[:, :3] - features[:, :3].mean(axis=0), axis=1)
    chosen = [int(np.argmin(middle))]
    distance, owner = from_(chosen[0]), np.zeros(len(points), int)
    while len(chosen) < count and distance.max() > radius:
        chosen.append(int(np.argmax(distance)))
        away = from_(chosen[-1])
        owner[away < distance] = len(chosen) - 1
        distance = np.minimum(distance, away)
    return Clusters(features[chosen], bend, float(distance.max()), np.array(chosen)), owner


def bases_of_clusters(
    columns: Float[np.ndarray, "P n"], owner: Int[np.ndarray, " P"], count: int, size: int
) -> Float[np.ndarray, "P K"]:
    """The `size` leading left singular vectors of the rows of each cluster; zeros where it has no such rank.

    The values at a point are those of its own cluster's vectors, which are orthonormal. Float64; not differentiable.
    """
    out = np.zeros((len(owner), size))
    for cluster in range(count):
        rows = np.flatnonzero(owner == cluster)
        if len(rows):
            found = principal_rows(columns[rows].T.astype(np.float64), size).T
            out[rows, : found.shape[1]] = found
    return out


def apart(basis: Float[np.ndarray, "P K"], owner: Int[np.ndarray, " P"], count: int) -> Float[np.ndarray, "P Q"]:
    """Functions of all clusters as columns of their own, Q = count · K, each zero outside of its cluster."""
    points, size = basis.shape
    out = np.zeros((points, count, size))
    out[np.arange(points), owner] = basis
    return out.reshape(points, -1)


def in_clusters(
    basis: Float[np.ndarray, "P K"],
    values: Float[np.ndarray, "P ..."],
    owner: Int[np.ndarray, " P"],
    count: int,
) -> Float[np.ndarray, "Q ..."]:
    """Coefficients of values at the points on the functions of each cluster, one cluster's after another's."""
    parts = []
    for cluster in range(count):
        rows = owner == cluster
        parts.append(np.tensordot(basis[rows], values[rows], (0, 0)))
    return np.concatenate(parts)


def _features(points: SurfacePoints, bend: float) -> Float[np.ndarray, "p 6"]:
    return np.hstack([points.position, bend * points.normal]).astype(float)
