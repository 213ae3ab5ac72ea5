"""Light through a missing face of a cube, in few numbers: how it leaves a block, goes on through blocks, and arrives.

A lightfield is radiance at `places`² points of a square interface and `turns`² directions through it. Directions are the
middles of equal parts of the unit disk under the hemisphere (cos θ = √(1 − r²)), so every entry carries the same share of
the flux, and the plain inner product is that of energy. Coordinates on an interface are to the right and up, seen along the
light, in the frame of its direction (`rotations`), with +y up where light is level; canonical light leaves through +x, or
enters through −x and goes on along +x. Propagation within a block is then straight, left or right in flat levels. In three
dimensions it is also up and down, and all but straight are the left one between rolls about the direction.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, vstack

from prt_bench.linalg import leading_basis
from prt_bench.modular.cube import Met, bilinear, cosine_rays, disk, interpolation, meet, sample_points, square
from prt_bench.modular.modes import factors
from prt_bench.modular.rotations import ROTATIONS

EXITS = {"straight": 0, "left": 5, "right": 4}
"""The faces that light along +x leaves through."""
_ENTRANCE = 1  # the face −x
_FINE = 3  # directions across each part of the disk


class Grid(NamedTuple):
    """Resolution of a lightfield: points and directions along a side."""

    places: int = 12
    turns: int = 24

    @property
    def size(self) -> int:
        """Numbers of a lightfield."""
        return self.places**2 * self.turns**2


def ways_of(dimension: int) -> tuple[str, ...]:
    """Of `EXITS`, those that are kept: in three dimensions right is left between rolls."""
    return tuple(EXITS)[: 5 - dimension]


def emission(side: int, grid: Grid) -> csr_array:
    """From the radiosity of a cube's samples to the lightfield that leaves through +x: [s, n], radiance = radiosity / π."""
    origin, direction = _leaving("straight", grid)
    return interpolation(origin, -direction, side) / (np.pi * direction.shape[1])


def propagation(way: str, grid: Grid) -> csr_array:
    """From a lightfield that enters through −x to that which leaves by one of `EXITS`, unless it meets a face."""
    origin, direction = _leaving(way, grid)
    rays = direction.shape[1]
    met = meet(np.repeat(origin, rays, axis=0), -direction.reshape(-1, 3))
    return at_entrance(met, direction.reshape(-1, 3), np.repeat(np.arange(grid.size), rays), grid, grid.size) / rays


def response(side: int, grid: Grid, across: int = 64) -> csr_array:
    """From a lightfield that enters through −x to irradiance at the samples: [n, s], by `across`² rays from each."""
    position, normal = sample_points(side)
    rays = across * across
    parts = []
    for at in range(0, len(position), 256):
        rows = slice(at, at + 256)
        direction = cosine_rays(normal[rows], across).reshape(-1, 3)
        owner = np.repeat(np.arange(len(position[rows])), rays)
        met = meet(np.repeat(position[rows], rays, axis=0), direction)
        parts.append(at_entrance(met, -direction, owner, grid, len(position[rows])))
    return csr_array(vstack(parts)) * (np.pi / rays)


def rolling(grid: Grid) -> Int[np.ndarray, " s"]:
    """p with h[p] a lightfield after a quarter turn about its direction, from up to the right."""
    number = np.arange(grid.size).reshape(grid.places, grid.places, grid.turns, grid.turns)
    return number[:, ::-1, :, ::-1].transpose(1, 0, 3, 2).ravel()  # up and right of the place, then of the direction


def _frame(exit_: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """To the right, up and along, for light that leaves through a face."""
    along, up, right = ROTATIONS[exit_].T.astype(float)
    return right, up, along


def _leaving(way: str, grid: Grid) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s R 3"]]:
    """Places of a lightfield that leaves a block, and `_FINE`² directions for each."""
    right, up, along = _frame(EXITS[way])
    middles = (np.arange(grid.places) + 0.5) / grid.places - 0.5
    t, s = (part.reshape(-1, 1) for part in np.meshgrid(middles, middles, indexing="ij"))
    origin = 0.5 * along + s * right + t * up
    direction = directions(grid) @ np.stack([right, up, along])
    return np.repeat(origin, grid.turns**2, axis=0), np.tile(direction, (grid.places**2, 1, 1))


def directions(grid: Grid) -> Float[np.ndarray, "t R 3"]:
    """`_FINE`² directions within each part of the hemisphere, to the right, up and along."""
    cells = (np.arange(grid.turns * _FINE) + 0.5) / (grid.turns * _FINE)
    b, a = (part.reshape(grid.turns, _FINE, grid.turns, _FINE) for part in np.meshgrid(cells, cells, indexing="ij"))
    x, y = disk(*(part.transpose(0, 2, 1, 3).reshape(grid.turns**2, _FINE**2) for part in (a, b)))
    return np.stack([x, y, np.sqrt(np.maximum(0.0, 1.0 - x * x - y * y))], axis=2)


def at_entrance(met: Met, direction: Float[np.ndarray, "n 3"], owner: np.ndarray, grid: Grid, rows: int) -> csr_array:
    """`looked_up` at the entrance for the rays that meet it."""
    through = np.flatnonzero(met.face == _ENTRANCE)
    right, up, _ = _frame(EXITS["straight"])
    # Fractions of face −x are along y and z, which are up and right.
    where, towards = (met.v[through], met.u[through]), direction[through]
    return looked_up(where, (towards @ right, towards @ up), owner[through], grid, rows)


def looked_up(
    where: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    towards: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    owner: Int[np.ndarray, " n"],
    grid: Grid,
    rows: int,
) -> csr_array:
    """Interpolation in a lightfield, summed over the rays of each row: [rows, s].

    Rays pass the interface at fractions to the right and up, along directions with these parts to the right and up.
    """
    none = np.zeros(len(owner), int)
    place_at, place_weight = bilinear(Met(none, *where), grid.places)
    turn_at, turn_weight = bilinear(Met(none, *square(*towards)), grid.turns)
    columns = place_at[:, :, None] * grid.turns**2 + turn_at[:, None, :]
    weights = place_weight[:, :, None] * turn_weight[:, None, :]
    table = csr_array((weights.ravel(), (np.repeat(owner, 16), columns.ravel())), shape=(rows, grid.size))
    table.sum_duplicates()
    return table


def spanning(
    lightfields: Float[np.ndarray, "s m"],
    ways: list[csr_array],
    count: int,
    roll: Int[np.ndarray, " s"] | None = None,
    rounds: int = 3,
) -> Float[np.ndarray, "s k"]:
    """H [s, k]: an orthonormal basis of lightfields that leave blocks, and of what `rounds` steps through blocks make of them.

    After each step what it gives is scaled to the norm of the basis before it, put beside it, and the leading vectors of both
    are kept. With `roll`, which is `rolling`, `ways` are straight on and left, these are of all four rolls, and the span is
    closed under them.
    """
    found = _leading(lightfields / np.linalg.norm(lightfields), count)
    if roll is not None:
        found = _closed(found[:, :0], found, count, roll)
    for _ in range(rounds):
        moved = [way @ found for way in ways]
        found = found / np.linalg.norm(found)
        if roll is None:
            beside = np.concatenate(moved, axis=1)
            found = _leading(np.concatenate([found, beside / np.linalg.norm(beside)], axis=1), count)
        else:
            straight, left = moved
            size = np.hypot(np.linalg.norm(straight), 2.0 * np.linalg.norm(left))
            found = _closed(np.concatenate([found, straight / size], axis=1), left / size, count, roll)
    size = np.linalg.norm(found, axis=0)
    return found[:, size > 0] / size[size > 0]


def rolled(span: Float[np.ndarray, "s k"], roll: Int[np.ndarray, " s"]) -> Float[np.ndarray, "k k"]:
    """The orthogonal matrix of a roll within a span that is closed under it."""
    u, _, vt = factors(span.T @ span[roll])
    return u @ vt


def _closed(closed: np.ndarray, columns: np.ndarray, count: int, roll: np.ndarray) -> np.ndarray:
    """Leading vectors, times singular values, of columns in all four rolls beside others whose rolls change nothing.

    Half a turn keeps a lightfield, or negates it, or it is a sum of two such, which are orthogonal; of each, one row stands for
    two. Of the negated ones a vector and its roll have the same singular value, and both are kept.
    """
    half, parts = roll[roll], []
    rows = np.flatnonzero(half >= np.arange(len(half)))
    weight = np.where(half[rows] == rows, 1.0, 0.5**0.5)[:, None]
    for sign in (1.0, -1.0):
        fixed, *rolls = (part[rows] + sign * part[half[rows]] for part in (closed, columns, columns[roll]))
        vectors = _leading(np.concatenate([0.5 * fixed, *(0.5**0.5 * part for part in rolls)], axis=1) / weight, count)
        whole = np.empty((len(half), vectors.shape[1]))
        whole[rows], whole[half[rows]] = weight * vectors, sign * weight * vectors
        parts.append(whole)
    sizes = [np.linalg.norm(part, axis=0) for part in parts]
    odd = int(np.sum(np.argsort(-np.concatenate(sizes))[:count] >= len(sizes[0]))) // 2 * 2
    return np.concatenate([parts[0][:, : count - odd], parts[1][:, :odd]], axis=1)


def _leading(columns: np.ndarray, count: int) -> np.ndarray:
    """Leading left singular vectors times singular values."""
    vectors, values = (
        np.asarray(part) for part in leading_basis(jnp.asarray(columns), min(count, columns.shape[1]), 0.0)
    )
    return vectors * values[: vectors.shape[1]]


def contracted(matrix: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """The nearest matrix with no singular value above 1: light that passes through a block is not amplified."""
    u, s, vt = factors(matrix)
    return (u * np.minimum(s, 1.0)) @ vt
