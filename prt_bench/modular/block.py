"""One block for a scene: the cube that its bounding box is, where surfaces lie on it, and what reaches points within it.

The source paper warps a cube of the dictionary onto a scene, takes the light on each surface to the face that a cube map
shows it on, and shows the light of that face. Here surfaces are read by the faces that they are parallel to, and receivers
gather from the box where they are, along rays through nothing but air: furniture is lit for what it is, a long box sends no
more light along its axis than it should, and no seams arise (Loos et al. 2011, Sections 7.2 and 8).
"""

from collections.abc import Sequence
from functools import cache

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from prt_bench.modular.cube import FACES, Met, bilinear, cosine_rays, interpolation
from prt_bench.modular.modes import Modes, reduced
from prt_bench.points import SurfacePoints
from prt_bench.scene import Mesh

COVERED = 0.25
"""A face of the box is there where surfaces that look away from it have this share of its area."""
_ACROSS = 16  # rays of a receiver, squared
_POINTS = 4096  # receivers at once


class Box(eqx.Module):
    """An axis-aligned box, `low` and `extent` in metres. No edge is shorter than a thousandth of the longest."""

    low: Float[np.ndarray, "3"]
    extent: Float[np.ndarray, "3"]

    @classmethod
    def around(cls, bounds: Float[np.ndarray, "2 3"]) -> "Box":
        """The bounding box of a scene."""
        extent = np.ptp(bounds, axis=0)
        wide = np.maximum(extent, 1e-3 * extent.max())
        return cls(bounds.mean(axis=0) - 0.5 * wide, wide)

    @property
    def areas(self) -> Float[np.ndarray, "6"]:
        """Of its faces, in m²."""
        return np.repeat(np.prod(self.extent) / self.extent, 2)

    def local(self, position: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Positions in the unit cube about the origin; those outside are put on its surface."""
        return np.clip((position - self.low) / self.extent - 0.5, -0.5, 0.5)


def shares(normal: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 6"]:
    """How much a surface belongs to each face: the squares of its normal's components, which sum to 1, by their signs."""
    towards = np.stack([-normal, normal], axis=2).reshape(-1, FACES)  # +x has the inward normal −x
    return np.maximum(towards, 0.0) ** 2 / np.maximum(np.sum(normal**2, axis=1, keepdims=True), np.finfo(float).tiny)


def covered(
    box: Box,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    area: Float[np.ndarray, " P"] | float,
) -> Bool[np.ndarray, "6"]:
    """Faces that enough surface in the half of the box next to them looks away from, of pieces of surface of so many m²."""
    local = box.local(position)
    near = np.stack([local > 0, local <= 0], axis=2).reshape(-1, FACES)
    return np.sum(np.reshape(area, (-1, 1)) * shares(normal) * near, axis=0) >= COVERED * box.areas


def missing_faces(box: Box, mesh: Mesh) -> tuple[int, ...]:
    """Faces that too little surface in the half of the box next to them looks away from.

    Where fewer than two are left, about a single body, none is missing: what the body sends out is taken to come back.
    """
    missing = np.flatnonzero(~covered(box, mesh.triangles.mean(axis=1), mesh.normals, mesh.areas))
    return tuple(missing.tolist()) if len(missing) < FACES - 1 else ()


def observation(box: Box, points: SurfacePoints, side: int) -> csr_array:
    """A [M, n]: the radiosity at points as the samples of the cube's faces have it, interpolated."""
    local, weight = box.local(points.position) + 0.5, shares(points.normal)
    point, face = np.nonzero(weight)
    axis = face // 2
    met = Met(face, local[point, (axis + 1) % 3], local[point, (axis + 2) % 3])
    columns, parts = bilinear(met, side)
    parts = parts * weight[point, face, None]
    rows = np.repeat(point, parts.shape[1])
    return csr_array((parts.ravel(), (rows, columns.ravel())), shape=(len(points), FACES * side * side))


def on_faces(seen: csr_array, values: Float[np.ndarray, "P C"]) -> Float[np.ndarray, "n C"]:
    """Values of the cube's samples from those of points: means of the points near each, or else of its face, or of all."""
    weight = np.asarray(seen.sum(axis=0)).reshape(FACES, -1, 1)
    sums = (seen.T @ values).reshape(FACES, weight.shape[1], -1)
    found = np.zeros(())
    for axis in ((0, 1), (1,), ()):
        total = weight.sum(axis=axis, keepdims=True)
        found = np.where(total > 0, sums.sum(axis=axis, keepdims=True) / np.where(total > 0, total, 1.0), found)
    return np.broadcast_to(found, sums.shape).reshape(-1, sums.shape[2])


def received(
    box: Box, points: SurfacePoints, sent: Float[np.ndarray, "n B"], side: int, across: int = _ACROSS
) -> Float[np.ndarray, "P B"]:
    """Irradiance at points within the box from the radiosity of its faces, by `across`² rays each."""
    found = np.empty((len(points), sent.shape[1]))
    for start in range(0, len(points), _POINTS):
        rows = slice(start, start + _POINTS)
        rays = cosine_rays(points.normal[rows], across) / box.extent
        found[rows] = interpolation(box.local(points.position[rows]), rays, side) @ sent / across**2
    return found


@cache
def modes_of(side: int, missing: Sequence[int], functions: int, prior: int, lights: int) -> Modes:
    """`reduced` of a cube, kept for the next scene that is a block of this kind."""
    return reduced(side, missing, functions, prior, lights)
