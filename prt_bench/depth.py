"""Visibility of local lights from compressed hemispheres of depth: principal components of each cluster's depth buffers.

Light anywhere in the scene is compared with the depth along its direction, so that no shadow map is drawn. Who traces the
buffers is in `data_gen/meshless.py`; how entries are dropped and quantised is in `prt_bench/packing.py`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from prt_bench.errors import FitError
from prt_bench.hemisphere import tangent_frames
from prt_bench.linalg import principal_rows
from prt_bench.packing import Packed, packed, threshold
from prt_bench.points import SurfacePoints

SLACK = 0.05
"""How far behind a surface a light may lie and still be seen, as a share of its distance."""
_CORNERS = 4
_PAIRS = 1 << 15  # pairs of sample and light at once


def hemisphere_directions(count: int) -> Float[np.ndarray, "d 3"]:
    """`count` unit directions about z, of equal solid angle, on a spiral of golden angles."""
    index = np.arange(count) + 0.5
    z, angle = 1.0 - index / count, np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


class DirectionGrid(NamedTuple):
    """Which of some directions can be among the four nearest to any other: the lookup by which shaders find those.

    Cells are `side`² squares over the disk (x, y) / √(1 + z), which keeps areas. Those of cell i = row · side + column are
    `candidates[starts[i] : starts[i + 1]]`; cells off the disk have none.
    """

    side: int
    starts: Int[np.ndarray, " cells"]
    candidates: Int[np.ndarray, " n"]

    @classmethod
    def of(cls, directions: Float[np.ndarray, "d 3"]) -> "DirectionGrid":
        """For d ≥ 4 directions. No further than to the fourth nearest of a cell's middle and twice across half the cell."""
        side = 2 * int(np.ceil(np.sqrt(len(directions))))
        middle = (2.0 * np.arange(side) + 1.0) / side - 1.0
        place = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
        corner = np.sqrt(2.0) / side
        squared = np.sum(place**2, axis=1)
        on_disk = np.flatnonzero(squared <= (1.0 + corner) ** 2)
        squared = squared[on_disk]
        around = np.column_stack([place[on_disk] * np.sqrt(2.0 - squared)[:, None], 1.0 - squared])
        # What a length on the disk is at most on the sphere, anywhere in the cell.
        stretch = 2.0 / np.sqrt(2.0 - (np.sqrt(squared) + corner) ** 2)
        tree = KDTree(directions)
        fourth = np.asarray(tree.query(around, k=_CORNERS)[0])[:, -1]
        found = tree.query_ball_point(around, fourth + 2.002 * stretch * corner, return_sorted=True)
        sizes = np.zeros(side**2, int)
        sizes[on_disk] = [len(each) for each in found]
        return cls(side, np.concatenate([[0], np.cumsum(sizes)]), np.concatenate(found).astype(int))


class ClusteredVisibility(NamedTuple):
    """Depth of each sample as `mean` [P, d] of its cluster plus `coefficients` [S, K] on its cluster's `basis` [P, d, K].

    What is stored of a distance r is 1 / (r + `near`), in 1/m: 0 where a ray escapes, and bounded at corners. Being affine it
    keeps the paper's mean: depth has no intensity, so that nothing has to scale. `directions` [d, 3] are in the unturned
    `tangent_frames` of each sample, which are alike for neighbours on a surface. Not differentiable. After "clustered PCA with
    local lights", eqs. 7 to 9 and Section 4.2.
    """

    directions: Float[np.ndarray, "d 3"]
    cluster: Int[np.ndarray, " S"]
    mean: Float[np.ndarray, "P d"]
    basis: Float[np.ndarray, "P d K"]
    coefficients: Float[np.ndarray, "S K"]
    near: float

    @classmethod
    def fit(
        cls,
        depth: Float[np.ndarray, "S d"],
        directions: Float[np.ndarray, "d 3"],
        cluster: Int[np.ndarray, " S"],
        size: int,
        near: float,
    ) -> "ClusteredVisibility":
        """`size` principal components of each cluster's buffers. Raises `FitError` for NaN and for sizes below 1."""
        if size < 1 or near <= 0:
            raise FitError(
                f"visibility has {size} components and a nearest distance of {near:g} m; both must be positive"
            )
        if np.isnan(depth).any():
            raise FitError("depth buffers hold NaN; trace them again")
        count = int(cluster.max()) + 1
        mean, basis = np.zeros((count, depth.shape[1])), np.zeros((count, depth.shape[1], size))
        coefficients = np.zeros((len(depth), size))
        for index in range(count):
            rows = np.flatnonzero(cluster == index)
            if not len(rows):
                continue
            stored = 1.0 / (depth[rows].astype(np.float64) + near)
            mean[index] = stored.mean(axis=0)
            centred = stored - mean[index]
            found = principal_rows(centred, size)
            basis[index, :, : len(found)] = found.T
            coefficients[rows] = centred @ basis[index]
        return cls(directions, cluster, mean, basis, coefficients, near)

    def truncated(self, size: int) -> "ClusteredVisibility":
        """The same with the first `size` components."""
        return self._replace(
            basis=np.ascontiguousarray(self.basis[:, :, :size]), coefficients=self.coefficients[:, :size]
        )

    def quantised(self, share: float = 1.0) -> "ClusteredVisibility":
        """As the runtime holds it: coefficients and functions in 16 bits, the mean in float32; `share` as in `packed`."""
        coefficients, functions = self.packed(share)
        clusters, directions, size = self.basis.shape
        basis = np.moveaxis(functions.unpacked().reshape(directions, clusters, size), 1, 0)
        mean = self.mean.astype(np.float32)
        return self._replace(mean=mean, basis=np.ascontiguousarray(basis), coefficients=coefficients.unpacked())

    def packed(self, share: float = 1.0) -> tuple[Packed, Packed]:
        """Coefficients [S, K] and functions [d, P·K] with the largest `share` of the entries of both, in 16 bits.

        An error in a function meets every sample of its cluster, times its coefficient, and is weighted so.
        """
        functions = np.moveaxis(self.basis, 1, 0).reshape(self.basis.shape[1], -1)
        weight = np.zeros((len(self.basis), self.basis.shape[2]))
        np.add.at(weight, self.cluster, self.coefficients**2)
        weight = np.sqrt(weight).ravel()
        least = threshold(share, np.abs(self.coefficients), np.abs(functions) * weight)
        return packed(self.coefficients, least), packed(functions, least, weight)

    def lit(
        self, points: SurfacePoints, lights: Float[np.ndarray, "L 3"], slack: float = SLACK
    ) -> Float[np.ndarray, "L S"]:
        """How much of point lights at `lights` each sample sees, from 0 to 1; 0 for lights below its horizon.

        The depths along the four nearest directions are compared with the light's distance, each by itself, and weighted
        by nearness: a shadow's edge is as soft as the directions are apart. A light counts as seen up to `slack` of its
        distance behind the surface.
        """
        tree, turn = KDTree(self.directions), tangent_frames(points.normal, np.zeros(len(points)))
        out = np.zeros((len(lights), len(points)))
        for row, light in enumerate(lights):
            away = light - points.position
            distance = np.linalg.norm(away, axis=1)
            local = np.einsum("pdx,px->pd", turn, away / distance[:, None])
            above = np.flatnonzero(local[:, 2] > 0)
            gap, near = map(np.asarray, tree.query(local[above], k=_CORNERS))
            weight = 1.0 / (gap + 1e-6)
            limit = 1.0 / ((1.0 - slack) * distance[above] + self.near)
            seen = self.stored(above, near) <= limit[:, None]
            out[row, above] = (weight * seen).sum(axis=1) / weight.sum(axis=1)
        return out

    def stored(self, samples: Int[np.ndarray, " n"], chosen: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Reconstructed 1 / (r + near) of some samples along some of the directions."""
        owner = self.cluster[samples]
        out = np.empty(chosen.shape)
        for start in range(0, len(samples), _PAIRS):
            rows = slice(start, start + _PAIRS)
            part = self.basis[owner[rows, None], chosen[rows]]
            out[rows] = (part @ self.coefficients[samples[rows], :, None])[:, :, 0]
        return out + self.mean[owner[:, None], chosen]


def shadow_error(
    found: Float[np.ndarray, "L S"], wanted: Bool[np.ndarray, "L S"], weight: Float[np.ndarray, "L S"]
) -> float:
    """‖weight · (found − wanted)‖ / ‖weight · wanted‖: the relative error of direct light; `weight` is what is unshadowed."""
    return float(np.linalg.norm(weight * (found - wanted)) / np.linalg.norm(weight * wanted))
