"""Pipes as seen from inside: a straight one and a quarter bend, samples on their walls, and what a ray from within meets.

Lengths are in edges of the cell that a pipe crosses, which is centred at the origin. Both pipes have the radius `RADIUS` and
enter their cell through −x along +x; the straight one leaves through +x, the bend turns left, about (−½, 0, −½), and leaves
through −z. A place on a wall is a fraction along the pipe and one around it, from the right towards +y as seen along the pipe;
sample (i, j) of `side`² is row i side + j, at the middle of its part. A bend to the right is the mirror image of one to the
left, and a pipe seen from its other end a straight pipe or a bend again: all are these two with samples in another order.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from prt_bench.modular.cube import cosine_rays

RADIUS = 0.3
"""Of every pipe."""
AXIS = 0.5
"""Radius of the circle that the axis of a bend is a quarter of."""
UP = np.array([0.0, 1.0, 0.0])
AS_IS, BACK, MIRRORED, ALONG = range(4)
"""Rows of `orders`: as samples are, from the other end, mirrored from right to left, and both."""
_STEP = 1e-3  # of a march, at least: what is missed at a wall is a millionth of that
_MARCH = 4000
_LOOKS = 24  # between a light and a place on a wall
_SCALINGS = 64


class Frame(NamedTuple):
    """A cross-section: its middle, its right and the direction along the pipe."""

    middle: Float[np.ndarray, "n 3"]
    right: Float[np.ndarray, "n 3"]
    along: Float[np.ndarray, "n 3"]


class Hit(NamedTuple):
    """Where rays meet the wall of a pipe that goes on beyond its ends: fractions along, not from 0 to 1 there, and around."""

    along: Float[np.ndarray, " n"]
    around: Float[np.ndarray, " n"]


class Pipe(ABC):
    """A pipe without end, of which `along` from 0 to 1 is in the cell; `images` are the `orders` in which it looks the same."""

    images: ClassVar[tuple[int, ...]]

    @abstractmethod
    def frame(self, along: Float[np.ndarray, " n"]) -> Frame:
        """Cross-sections."""

    @abstractmethod
    def along(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The cross-section that points lie in."""

    @abstractmethod
    def meet(self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Hit:
        """Where rays from within, or from the wall inward, meet the wall."""

    @abstractmethod
    def weights(self, around: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Area of wall over the mean."""

    @abstractmethod
    def sees(self, light: Float[np.ndarray, "m 3"], position: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "m n"]:
        """Which places on the wall lights see that are in the pipe, or in straight pipes that go on from its ends."""

    def place(
        self, along: Float[np.ndarray, " n"], around: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Positions on the wall and inward normals there."""
        middle, right, _ = self.frame(along)
        angle = 2.0 * np.pi * around[:, None]
        outward = np.cos(angle) * right + np.sin(angle) * UP
        return middle + RADIUS * outward, -outward

    def samples(self, side: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Positions and inward normals of all samples, and the share of the mean area that each stands for."""
        middles = (np.arange(side) + 0.5) / side
        along, around = np.repeat(middles, side), np.tile(middles, side)
        return *self.place(along, around), self.weights(around)

    def around(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The fraction around the pipe in which points lie, from 0 to 1."""
        middle, right, _ = self.frame(self.along(position))
        away = position - middle
        return np.mod(np.arctan2(away @ UP, np.sum(away * right, axis=1)) / (2.0 * np.pi), 1.0)


class Straight(Pipe):
    """A cylinder along x."""

    images = (AS_IS, BACK, MIRRORED, ALONG)

    def frame(self, along: Float[np.ndarray, " n"]) -> Frame:
        """Cross-sections."""
        middle = np.stack([along - 0.5, np.zeros_like(along), np.zeros_like(along)], axis=1)
        ones = np.ones((len(along), 1))
        return Frame(middle, ones * [0.0, 0.0, 1.0], ones * [1.0, 0.0, 0.0])

    def along(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The cross-section that points lie in."""
        return position[:, 0] + 0.5

    def meet(self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Hit:
        """The greater root of |o + t d|² = r² across the axis; a ray along the axis meets the wall far away."""
        across, start = direction[:, 1:], origin[:, 1:]
        square = np.maximum(np.sum(across**2, axis=1), 1e-12)
        towards = np.sum(across * start, axis=1)
        inside = np.maximum(RADIUS**2 - np.sum(start**2, axis=1), 0.0)
        point = origin + ((np.sqrt(towards**2 + square * inside) - towards) / square)[:, None] * direction
        return Hit(self.along(point), self.around(point))

    def weights(self, around: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Everywhere 1."""
        return np.ones_like(around)

    def sees(self, light: Float[np.ndarray, "m 3"], position: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "m n"]:
        """All: a cylinder is convex."""
        return np.ones((len(light), len(position)), bool)


class Bend(Pipe):
    """A torus about a vertical axis, of which a quarter is in the cell."""

    images = (AS_IS, ALONG)

    def frame(self, along: Float[np.ndarray, " n"]) -> Frame:
        """Cross-sections; the right is away from what the bend turns about."""
        angle = 0.5 * np.pi * along
        sine, cosine, none = np.sin(angle), np.cos(angle), np.zeros_like(angle)
        right = np.stack([sine, none, cosine], axis=1)
        return Frame(AXIS * right - [0.5, 0.0, 0.5], right, np.stack([cosine, none, -sine], axis=1))

    def along(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The cross-section that points lie in, from −2 to 2."""
        return np.arctan2(position[:, 0] + 0.5, position[:, 2] + 0.5) / (0.5 * np.pi)

    def meet(self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Hit:
        """By steps as long as the wall is away, at least `_STEP`, and a line between the last two once one ends outside.

        A ray goes less than halfway about the axis of the torus, so how far it goes is never in doubt.
        """
        distance, before = np.zeros(len(origin)), np.maximum(self._room(origin), 0.0)
        rows = np.arange(len(origin))
        for _ in range(_MARCH):
            step = np.maximum(before[rows], _STEP)
            after = self._room(origin[rows] + (distance[rows] + step)[:, None] * direction[rows])
            out = after <= 0
            share = np.divide(
                before[rows], before[rows] - after, out=np.zeros_like(after), where=out & (before[rows] > 0)
            )
            distance[rows] += np.where(out, share, 1.0) * step
            before[rows] = after
            rows = rows[~out]
            if not len(rows):
                break
        point = origin + distance[:, None] * direction
        start = self.along(origin)
        return Hit(start + np.mod(self.along(point) - start + 2.0, 4.0) - 2.0, self.around(point))

    def _room(self, position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance to the wall from within."""
        beside = np.hypot(position[:, 0] + 0.5, position[:, 2] + 0.5) - AXIS
        return RADIUS - np.hypot(beside, position[:, 1])

    def weights(self, around: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Greater on the right, which is farther from the axis."""
        return 1.0 + RADIUS / AXIS * np.cos(2.0 * np.pi * around)

    def sees(self, light: Float[np.ndarray, "m 3"], position: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "m n"]:
        """Where places between lie in the torus or, beyond its ends, in the cylinders that touch it there."""
        found = np.ones((len(light), len(position)), bool)
        for share in (np.arange(_LOOKS) + 0.5) / _LOOKS:
            x, y, z = np.moveaxis((1.0 - share) * light[:, None] + share * position, 2, 0)
            beside = np.where(x < -0.5, z, np.where(z < -0.5, x, np.hypot(x + 0.5, z + 0.5) - AXIS))
            found &= np.hypot(beside, y) <= RADIUS * (1.0 + 1e-6)
        return found


SHAPES: tuple[Pipe, ...] = (Straight(), Bend())


def orders(side: int) -> Int[np.ndarray, "4 n"]:
    """Orders p of samples, `AS_IS` to `ALONG`; x[p] is light x so seen.

    From the other end, right is left as well; so both, the other end and mirrored, is another order along the pipe alone.
    """
    rows = np.arange(side * side).reshape(side, side)
    mirrored = rows[:, (side // 2 - 1 - np.arange(side)) % side]
    return np.stack([rows.ravel(), mirrored[::-1].ravel(), mirrored.ravel(), rows[::-1].ravel()])


def bilinear(hit: Hit, side: int) -> tuple[Int[np.ndarray, "n 4"], Float[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
    """Samples along, samples around, and weights of what is interpolated at places on the wall.

    Samples along may be any whole numbers: from 0 to `side` − 1 in the pipe, others beyond its ends.
    """
    at, angle = hit.along * side - 0.5, hit.around * side - 0.5
    row, column = np.floor(at).astype(int), np.floor(angle).astype(int)
    up, on = at - row, angle - column
    rows = row[:, None] + [0, 0, 1, 1]
    columns = (column[:, None] + [0, 1, 0, 1]) % side
    return rows, columns, np.stack([(1 - up) * (1 - on), (1 - up) * on, up * (1 - on), up * on], axis=1)


def ring(pipe: Pipe, side: int, across: int) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m R 3"], Hit]:
    """The samples around a pipe at its beginning, `across`² cosine-distributed rays from each, and what they meet."""
    position, normal = pipe.place(np.zeros(side), (np.arange(side) + 0.5) / side)
    rays = cosine_rays(normal, across)
    return position, rays, pipe.meet(np.repeat(position, across * across, axis=0), rays.reshape(-1, 3))


def one_bounce(pipe: Pipe, side: int) -> Float[np.ndarray, "n n"]:
    """F: irradiance at each sample from the radiosity of all; what is missing from the sum of a row leaves through the ends."""
    apart = np.arange(side) - np.arange(side)[:, None] + side - 1
    return _kernel(pipe, side)[:, :, apart].transpose(2, 0, 3, 1).reshape(side * side, side * side)


@cache
def _kernel(pipe: Pipe, side: int, across: int = 128) -> Float[np.ndarray, "side side apart"]:
    """What places around a pipe receive from places around it by how far these are along it, from −`side` + 1 to `side` − 1.

    How two places on the wall see each other depends on how far apart along the pipe they are, not on where: rays from one ring
    of samples tell all. Light goes both ways alike, by area, and a pipe without end loses none, so the kernel of that is made
    symmetric with rows that sum to 1 (scaled as by Sinkhorn and Knopp 1967) before it is cut at the ends.
    """
    _, _, hit = ring(pipe, side, across)
    rows, columns, weights = bilinear(Hit(hit.along + 0.5 / side, hit.around), side)
    reach = 2 * side - 1
    shift = np.where(np.abs(rows) < side, rows + side - 1, reach)  # the last for all that is farther
    start = np.repeat(np.arange(side), across * across)[:, None]
    flat = np.ravel_multi_index((np.broadcast_to(start, rows.shape), columns, shift), (side, side, reach + 1))
    kernel = np.bincount(flat.ravel(), weights.ravel(), side * side * (reach + 1)).reshape(side, side, reach + 1)
    kernel *= pipe.weights((np.arange(side) + 0.5) / side)[:, None, None] / across**2
    kernel[:, :, :-1] += kernel[:, :, -2::-1]  # the pipe from its other end, upside down
    kernel[:, :, -1] *= 2.0
    kernel += kernel[::-1, ::-1]
    kernel += kernel.swapaxes(0, 1)
    area, scale, sums = pipe.weights((np.arange(side) + 0.5) / side), np.ones(side), kernel.sum(axis=2)
    for _ in range(_SCALINGS):
        scale = np.sqrt(scale * area / (sums @ scale))
    kernel *= scale[:, None, None] * scale[:, None] / area[:, None, None]
    return kernel[:, :, :-1]


def wall_table(hit: Hit, side: int, owner: Int[np.ndarray, " n"], rows: int) -> csr_array:
    """Sum over the rays of each row of what is interpolated where they meet the wall of the pipe itself: [rows, side²]."""
    own = (hit.along >= 0) & (hit.along <= 1)
    along, around, weights = bilinear(Hit(hit.along[own], hit.around[own]), side)
    columns = np.clip(along, 0, side - 1) * side + around
    index = (np.repeat(owner[own], 4), columns.ravel())
    table = csr_array((weights.ravel(), index), shape=(rows, side * side))
    table.sum_duplicates()
    return table
