"""A unit cube as seen from inside: samples on its faces, what a ray from within meets, and the one-bounce operator.

Lengths are in edges of the cube, which is centred at the origin. Faces are +x, −x, +y, −y, +z, −z. Each has `side`² samples
at the middles of equal cells; sample (i, j) of face f, at fractions u and v along the next two axes, is row
f side² + j side + i. Operators here carry outgoing radiosity (what a surface sends out, in W/m²) to irradiance, so albedo
comes in where they are used.
"""

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

FACES = 6
_BATCH = 1 << 20  # rays at once
_SCALINGS = 64  # until sums of rows are 1 to rounding


class Met(NamedTuple):
    """Where rays meet the cube from within: the face, and fractions along the next two axes."""

    face: Int[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]


def sample_points(side: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Positions and inward unit normals of all 6 `side`² samples."""
    middles = (np.arange(side) + 0.5) / side
    v, u = (part.ravel() for part in np.meshgrid(middles, middles, indexing="ij"))
    faces = np.repeat(np.arange(FACES), side * side)
    return place(Met(faces, np.tile(u, FACES), np.tile(v, FACES))), inward(faces)


def place(met: Met) -> Float[np.ndarray, "n 3"]:
    """Positions of points on the faces."""
    axis, rows = met.face // 2, np.arange(len(met.face))
    found = np.empty((len(rows), 3))
    found[rows, axis] = np.where(met.face % 2 == 0, 0.5, -0.5)
    found[rows, (axis + 1) % 3] = met.u - 0.5
    found[rows, (axis + 2) % 3] = met.v - 0.5
    return found


def inward(face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Unit normals of faces, into the cube."""
    found = np.zeros((len(face), 3))
    found[np.arange(len(face)), face // 2] = np.where(face % 2 == 0, -1.0, 1.0)
    return found


def meet(origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Met:
    """Where rays from within the cube, or from its faces into it, meet a face."""
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(direction == 0.0, np.inf, (np.copysign(0.5, direction) - origin) / direction)
    axis = np.argmin(away, axis=1)
    rows = np.arange(len(axis))
    point = origin + away[rows, axis, None] * direction
    face = 2 * axis + (direction[rows, axis] < 0)
    u, v = (np.clip(point[rows, (axis + step) % 3] + 0.5, 0.0, 1.0) for step in (1, 2))
    return Met(face, u, v)


def bilinear(met: Met, side: int) -> tuple[Int[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
    """Samples whose light is interpolated at points of the faces, and their weights. Within half a cell of an edge the
    nearest samples of the same face stand for it."""
    column, right = _between(met.u, side)
    row, up = _between(met.v, side)
    rows, weights = [], []
    for j, i in product((0, 1), repeat=2):
        rows.append(met.face * side * side + (row + j) * side + column + i)
        weights.append((up if j else 1.0 - up) * (right if i else 1.0 - right))
    return np.stack(rows, axis=1), np.stack(weights, axis=1)


def _between(fraction: Float[np.ndarray, " n"], side: int) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The lower of two neighbouring cells, and the share of the other."""
    at = np.clip(fraction * side - 0.5, 0.0, side - 1.0)
    low = np.minimum(at.astype(int), side - 2)
    return low, at - low


def cosine_rays(normal: Float[np.ndarray, "n 3"], across: int) -> Float[np.ndarray, "n R 3"]:
    """R = `across`² unit directions over each normal, with density cos θ / π: the middles of equal parts of a disk."""
    middles = (np.arange(across) + 0.5) / across
    x, y = disk(*np.meshgrid(middles, middles))
    local = np.stack([x, y, np.sqrt(np.maximum(0.0, 1.0 - x * x - y * y))], axis=-1).reshape(-1, 3)
    return np.einsum("rk,nkc->nrc", local, frames(normal))


def frames(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Two unit vectors across each unit normal, right-handed with it, and the normal, as rows; axes where that is one."""
    first = np.eye(3)[(np.argmax(np.abs(normal), axis=1) + 1) % 3]
    first -= np.sum(first * normal, axis=1, keepdims=True) * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=1)


def disk(
    a: Float[np.ndarray, "*n"], b: Float[np.ndarray, "*n"]
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """The unit square on the unit disk, areas in proportion (Shirley and Chiu 1997, "A low distortion map")."""
    a, b = 2.0 * a - 1.0, 2.0 * b - 1.0
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    small = np.where(wide, b, a)
    angle = 0.25 * np.pi * np.divide(small, radius, out=np.zeros_like(radius), where=radius != 0)
    cosine, sine = radius * np.cos(angle), radius * np.sin(angle)
    return np.where(wide, cosine, sine), np.where(wide, sine, cosine)


def square(
    x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """The inverse of `disk`."""
    wide = np.abs(x) > np.abs(y)
    large, small = np.where(wide, x, y), np.where(wide, y, x)
    radius = np.copysign(np.hypot(x, y), large)
    slope = np.divide(small, large, out=np.zeros_like(large), where=large != 0)
    other = radius * np.arctan(slope) / (0.25 * np.pi)
    return 0.5 * (np.where(wide, radius, other) + 1.0), 0.5 * (np.where(wide, other, radius) + 1.0)


@cache
def one_bounce(side: int, across: int = 64) -> Float[np.ndarray, "n n"]:
    """F: irradiance at each sample from the radiosity of all, by `across`² rays from each and interpolation where they hit.

    Light goes both ways alike and none is lost in a closed cube, so F is made symmetric with rows that sum to 1 (scaled as
    by Sinkhorn and Knopp 1967), which makes it a contraction. A cube with missing faces has the same operator without their
    rows and columns, for nothing else stands between its points.
    """
    position, normal = sample_points(side)
    count, rays = len(position), across * across
    found = np.zeros((count, count))
    step = max(_BATCH // rays, 1)
    for at in range(0, count, step):
        rows = slice(at, min(at + step, count))
        table = interpolation(position[rows], cosine_rays(normal[rows], across), side)
        found[rows] = table.toarray() / rays
    found = 0.5 * (found + found.T)
    scale = np.ones(count)
    for _ in range(_SCALINGS):
        scale = np.sqrt(scale / (found @ scale))
    found *= scale[:, None] * scale
    found.flags.writeable = False
    return found


def interpolation(origin: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n R 3"], side: int) -> csr_array:
    """Sum over each point's rays of what is interpolated where they hit: a sparse matrix [n, 6 side²]."""
    count, rays = directions.shape[:2]
    met = meet(np.repeat(origin, rays, axis=0), directions.reshape(-1, 3))
    columns, weights = bilinear(met, side)
    start = np.arange(count + 1) * 4 * rays
    table = csr_array((weights.ravel(), columns.ravel(), start), shape=(count, FACES * side * side))
    table.sum_duplicates()
    return table
