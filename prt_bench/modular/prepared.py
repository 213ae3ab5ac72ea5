"""A level's operator made ready for frames on one core: what `LevelTransfer` multiplies, turned and sorted once.

Blocks that have the same faces missing have the same matrices once these are turned, so a group of them is one product. What
enters in the same direction is another. Light is channel by channel, and nothing is allocated in a frame.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from prt_bench.modular.level import LevelTransfer
from prt_bench.modular.rotations import ROTATIONS


class _Faces(NamedTuple):
    """Neighbouring faces that a group of blocks has: their samples, matrices [m, B] and [B, m], and light as rows."""

    samples: slice
    read: Float[np.ndarray, "m B"]
    basis: Float[np.ndarray, "B m"]
    light: Float[np.ndarray, "rows m"]


class _Group(NamedTuple):
    """Blocks with the same faces missing: their faces, and their b as rows."""

    blocks: slice
    faces: list[_Faces]
    b: Float[np.ndarray, "rows B"]


class _Way(NamedTuple):
    """Interfaces that light enters by in one direction: their r as rows, its matrix [R, n], what it gives, and on which faces
    of the blocks behind that is added to what is there."""

    r: Float[np.ndarray, "rows R"]
    response: Float[np.ndarray, "R n"]
    given: Float[np.ndarray, "rows n"]
    added: list[tuple[Float[np.ndarray, "C m"], Float[np.ndarray, "C m"]]]


class PreparedLevel:
    """The stages of `transfer` in float32 NumPy for C channels, with light [N, C, n] of its blocks in the order `order`.

    Stages leave their results in `b` [N, C, B], `r` [I, C, R], sorted by direction, and `light`, which the next call fills
    again. Nothing is differentiable.
    """

    def __init__(self, transfer: LevelTransfer, channels: int = 3) -> None:
        dictionary = transfer.dictionary
        read, basis, response = (np.asarray(part) for part in (dictionary.read, dictionary.basis, dictionary.arriving))
        kind, pose, turns = (np.asarray(part) for part in (transfer.kind, transfer.pose, transfer.turns))
        along, solid = np.asarray(transfer.along), np.asarray(transfer.solid)
        samples = basis.shape[1]
        shapes = (len(kind), basis.shape[2]), (len(along), response.shape[1]), (len(kind), samples)
        self.b, self.r, self.light = (np.zeros((rows, channels, columns), np.float32) for rows, columns in shapes)
        self._radiosity = np.zeros_like(self.light)

        self.order = np.lexsort((pose, kind))
        place = np.argsort(self.order)
        self._groups = []
        for first, blocks in _runs(kind[self.order] * len(ROTATIONS) + pose[self.order]):
            one = self.order[first]
            order = turns[pose[one]]
            turned, shown = read[kind[one]][:, order], basis[kind[one]][order]
            light = self.light[blocks].reshape(-1, samples)
            faces = [
                _Faces(
                    part, np.ascontiguousarray(turned[:, part].T), np.ascontiguousarray(shown[part].T), light[:, part]
                )
                for part in _there(solid[one])
            ]
            if faces:
                self._groups.append(_Group(blocks, faces, self.b[blocks].reshape(-1, basis.shape[2])))

        interfaces = np.argsort(along, kind="stable")
        behind = np.asarray(transfer.enters)[interfaces]
        self._ways = []
        for first, rows in _runs(along[interfaces]):
            matrix = np.ascontiguousarray(response[turns[along[interfaces[first]]]].T)
            given = np.empty((rows.stop - rows.start, channels, samples), np.float32)
            added = [
                (self.light[place[block]][:, part], light[:, part])
                for block, light in zip(behind[rows], given, strict=True)
                for part in _there(solid[block])
            ]
            r = self.r[rows].reshape(-1, response.shape[1])
            self._ways.append(_Way(r, matrix, given.reshape(-1, samples), added))
        to = np.argsort(interfaces)[np.asarray(transfer.pair_to)]
        pairs = np.argsort(to, kind="stable")
        self._pairs = np.ascontiguousarray(np.swapaxes(np.asarray(transfer.pairs)[pairs], 1, 2))
        self._from = place[np.asarray(transfer.pair_from)[pairs]]
        self._entered, self._starts = np.unique(to[pairs], return_index=True)
        self._parts = np.empty((len(self._from), *self.r.shape[1:]), np.float32)

    def coefficients(self, radiosity: Float[np.ndarray, "N C n"]) -> None:
        """b of every block."""
        samples = radiosity.shape[2]
        for group in self._groups:
            rows, (first, *others) = radiosity[group.blocks].reshape(-1, samples), group.faces
            np.matmul(rows[:, first.samples], first.read, out=group.b)
            for part in others:
                np.add(group.b, rows[:, part.samples] @ part.read, out=group.b)

    def arriving(self) -> None:
        """r of every interface, from b."""
        if len(self._pairs):
            np.matmul(self.b[self._from], self._pairs, out=self._parts)
            self.r[self._entered] = np.add.reduceat(self._parts, self._starts, axis=0)

    def indirect(self) -> None:
        """Irradiance at every block's samples, from b and r; 0 on missing faces."""
        for group in self._groups:
            for part in group.faces:
                np.matmul(group.b, part.basis, out=part.light)
        for way in self._ways:
            np.matmul(way.r, way.response, out=way.given)
            for light, given in way.added:
                np.add(light, given, out=light)

    def __call__(
        self, direct: Float[np.ndarray, "N C n"], albedo: Float[np.ndarray, "N C n"] | float, bounces: int = 1
    ) -> Float[np.ndarray, "N C n"]:
        """Indirect irradiance after so many bounces, each from what the one before it left."""
        self.light.fill(0.0)
        for _ in range(bounces):
            np.add(direct, self.light, out=self._radiosity)
            np.multiply(self._radiosity, albedo, out=self._radiosity)
            self.coefficients(self._radiosity)
            self.arriving()
            self.indirect()
        return self.light


def _runs(keys: Int[np.ndarray, " N"]) -> list[tuple[int, slice]]:
    """The first place of each run of equal keys, and the run."""
    _, starts, counts = np.unique(keys, return_index=True, return_counts=True)
    return [(int(first), slice(int(first), int(first + count))) for first, count in zip(starts, counts, strict=True)]


def _there(solid: Float[np.ndarray, " n"]) -> list[slice]:
    """Runs of samples on faces that are there."""
    edges = np.flatnonzero(np.diff(solid > 0, prepend=False, append=False)).tolist()
    return [slice(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True)]
