"""Light in a pipe and through its ends: a prior with its reduced operator, and lightfields that leave, go on and arrive.

A lightfield is as in `lightfield`, but on the disk that is an end of a pipe: its `places`² points are the middles of equal
parts of that disk, mapped from the square as directions are, so every entry carries the same share of the flux. Canonical
light leaves through the far end of a pipe, or enters through the near end.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from prt_bench.modular.cube import disk, square
from prt_bench.modular.lightfield import Grid, directions, looked_up
from prt_bench.modular.modes import RADIUS as LIGHT_RADIUS
from prt_bench.modular.modes import SHARE_OUTSIDE, Modes, refined, sphere_light, spread
from prt_bench.modular.pipe import ALONG, RADIUS, UP, Pipe, one_bounce, orders, ring, wall_table

_SECTORS, _PARTS = 4, 2
"""Around and along a pipe, of constants in the prior: floor, ceiling and both sides, of either half."""
_BEYOND = 0.7  # how far beyond an end lights of the prior stand


def direct_light(pipe: Pipe, side: int, lights: int) -> Float[np.ndarray, "n m"]:
    """Irradiance by at least `lights` sphere lights spread evenly in a pipe, and by a quarter as many beyond either end.

    Each light has its images by the symmetries of the pipe among them, so that what follows has these symmetries.
    """
    position, normal, _ = pipe.samples(side)
    inside = spread(-(-lights // len(pipe.images)))
    outside = inside[::SHARE_OUTSIDE]
    near, far = (pipe.frame(np.full(len(outside), end)) for end in (0.0, 1.0))
    step = _BEYOND * outside[:, :1]
    place = np.concatenate(
        [
            _across(*pipe.frame(inside[:, 0])[:2], inside),
            _across(near.middle - step * near.along, near.right, outside),
            _across(far.middle + step * far.along, far.right, outside),
        ]
    )
    light = sphere_light(place, position, normal) * pipe.sees(place, position).T
    return np.concatenate([light[order] for order in orders(side)[list(pipe.images)]], axis=1)


def _across(
    middle: Float[np.ndarray, "m 3"], right: Float[np.ndarray, "m 3"], at: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 3"]:
    """Places in cross-sections, as far from the wall as a light's surface has to be."""
    x, y = disk(at[:, 1], at[:, 2])
    return middle + (RADIUS - LIGHT_RADIUS) * (x[:, None] * right + y[:, None] * UP)


def reduced(pipe: Pipe, side: int, functions: int = 32, prior: int = 64, lights: int = 63) -> Modes:
    """The modes of a pipe with open ends, by `modes.refined` in the inner product of area.

    Its prior is enriched by functions that are constant on a part of the wall. `basis` is orthonormal by area.
    """
    _, _, area = pipe.samples(side)
    root = np.sqrt(area)
    transport = one_bounce(pipe, side) * root[:, None] / root
    rows = (np.arange(side) * _PARTS // side)[:, None] * _SECTORS
    # A sector lies about the right, the top, the left or the floor.
    columns = ((np.arange(side) + 0.5) * _SECTORS / side + 0.5).astype(int) % _SECTORS
    constants = np.eye(_PARTS * _SECTORS)[(rows + columns).ravel()]
    light = direct_light(pipe, side, lights)
    modes = refined(transport, light * root[:, None], constants * root[:, None], functions, prior)
    return Modes(
        modes.basis / root[:, None],
        modes.read * root,
        modes.implicit / root[:, None],
        modes.decay,
        modes.prior / root[:, None],
    )


class Passage(NamedTuple):
    """Light through a pipe: `leave` [s, n] from radiosity to the lightfield that leaves through the far end, and `onwards`
    [s, s] from the lightfield that enters through the near end to what of it leaves through the far one."""

    leave: csr_array
    onwards: csr_array


def passage(pipe: Pipe, side: int, grid: Grid) -> Passage:
    """What meets the wall against the light from each entry of the far end's lightfield, and what the near end."""
    middles = (np.arange(grid.places) + 0.5) / grid.places
    t, s = (part.ravel() for part in np.meshgrid(middles, middles, indexing="ij"))
    end = pipe.frame(np.ones(1))
    x, y = (RADIUS * part[:, None] for part in disk(s, t))
    local = directions(grid)
    rays = local.shape[1]
    towards = (local @ np.concatenate([end.right, UP[None], end.along])).reshape(-1, 3)
    origin = np.repeat(end.middle + x * end.right + y * UP, len(towards), axis=0)
    towards = np.tile(towards, (grid.places**2, 1))
    hit = pipe.meet(origin, -towards)
    owner = np.repeat(np.arange(grid.size), rays)
    leave = wall_table(hit, side, owner, grid.size) / (np.pi * rays)
    through = hit.along < 0
    onwards = _entering(pipe, origin[through], towards[through], owner[through], grid, grid.size) / rays
    return Passage(csr_array(leave), csr_array(onwards))


def _entering(
    pipe: Pipe,
    point: Float[np.ndarray, "m 3"],
    towards: Float[np.ndarray, "m 3"],
    owner: Int[np.ndarray, " m"],
    grid: Grid,
    rows: int,
) -> csr_array:
    """`looked_up` in the lightfield of the near end, for light that comes through it to these points along these directions."""
    near = pipe.frame(np.zeros(1))
    into, right = near.along[0], near.right[0]
    back = (point - near.middle) @ into / (towards @ into)
    met = point - near.middle - back[:, None] * towards
    x, y = met @ right / RADIUS, met @ UP / RADIUS
    beyond = np.maximum(np.hypot(x, y), 1.0)
    return looked_up(square(x / beyond, y / beyond), (towards @ right, towards @ UP), owner, grid, rows)


def response(
    pipe: Pipe, side: int, grid: Grid, span: Float[np.ndarray, "s k"], across: int = 48
) -> Float[np.ndarray, "n k"]:
    """From lightfields that enter through the near end, in k numbers, to irradiance on the wall, by `across`² rays from each
    sample.

    Rays of one ring of samples are those of all, moved along the pipe; those that would meet the wall before the near end bring
    light that came through it. Even light through both ends is all that `one_bounce` lacks, to which rows are scaled.
    """
    position, direction, hit = ring(pipe, side, across)
    start, rays = pipe.frame(np.zeros(1)), across * across
    frame = np.concatenate([start.right, UP[None], start.along])
    local, turned = (position - start.middle) @ frame.T, direction.reshape(-1, 3) @ frame.T
    owner, found = np.repeat(np.arange(side), rays), []
    fields = np.concatenate([span, np.ones((len(span), 1))], axis=1)
    for along in (np.arange(side) + 0.5) / side:
        here = pipe.frame(np.full(1, along))
        axes = np.concatenate([here.right, UP[None], here.along])
        through = np.flatnonzero(hit.along + along < 0)
        origin = (here.middle + local @ axes)[owner[through]]
        found.append(_entering(pipe, origin, -turned[through] @ axes, owner[through], grid, side) @ fields)
    light = np.concatenate(found)
    even = light[:, -1] + light[orders(side)[ALONG], -1]
    return light[:, :-1] * (np.pi * (1.0 - one_bounce(pipe, side).sum(axis=1)) / even)[:, None]


def mirrored(grid: Grid) -> Int[np.ndarray, " s"]:
    """p with h[p] the lightfield h with right and left exchanged."""
    return np.arange(grid.size).reshape(grid.places, grid.places, grid.turns, grid.turns)[:, ::-1, :, ::-1].ravel()
