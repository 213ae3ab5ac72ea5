"""A level as one linear map: from light at points of a scene to light at others, all bounces and all blocks in it.

Per block n, W_n reads b from radiosity at points in it; R carries the b of all blocks to those of the next bounce; T has what
enters through each interface. So y = O [U T] (1 + R + … ) W ρ x. Within a block that is light in the span of U and of what
arrives through each side; of it the leading functions are kept, for light as the prior of every block has it. Nothing is traced
or learned: albedo and places of points are all that is taken from a scene.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import csr_array

from prt_bench.linalg import ridge
from prt_bench.modular.block import Box, covered, observation, on_faces, received, shares
from prt_bench.modular.cube import FACES
from prt_bench.modular.dictionary import Dictionary
from prt_bench.modular.level import LevelTransfer, transfer
from prt_bench.modular.modes import factors, series
from prt_bench.modular.placed import Placed
from prt_bench.points import SurfacePoints

_ON_FACE = 0.02  # edges of a block that a point may be from its face, and share of its normal that may point elsewhere
_SMALL = 1e-9  # singular values below this share of the largest are rounding


class Joined(NamedTuple):
    """K functions for each of N blocks: values at the receivers' own block, the block, and the matrix from measured light."""

    basis: Float[np.ndarray, "T K"]
    block: Int[np.ndarray, " T"]
    matrix: Float[np.ndarray, "C NK M"]


class _Blocks(NamedTuple):
    """A level's operators in float64, samples in the order of the scene's axes."""

    within: Float[np.ndarray, "N n B"]
    read: Float[np.ndarray, "N B n"]
    prior: Float[np.ndarray, "N n p"]
    implicit: Float[np.ndarray, "N n B"]
    """The radiosity whose one bounce is `within`, in the span of the prior."""
    entering: list[tuple[Float[np.ndarray, "I n R"], Float[np.ndarray, "I R NB"]]]
    """For each block, of every interface into it: light at the samples, and what enters by the coefficients of all blocks."""


def joined(
    placed: Placed, dictionary: Dictionary, measured: SurfacePoints, samples: SurfacePoints, receivers: SurfacePoints,
    area: float, functions: int, ridge_factor: float, bounces: int, depth: int = 8, channels: int = 3,
) -> Joined:  # fmt: skip
    """Indirect light at `receivers` from direct light at the points `measured`; `samples` tell the albedo of the faces.

    Each sample stands for `area` m² of surface: a face that too little of it looks away from is black, for light to get out.
    `ridge_factor` is relative to the prior's light at the points; `depth` interfaces are passed at most. Raises `FitError` for
    points where the level has no block.
    """
    blocks = _operators(transfer(placed.level, dictionary, depth))
    seen, lit = placed.owner(measured), placed.owner(receivers)
    reading, spread, onwards = _between_bounces(placed, blocks, measured, seen, samples, area, ridge_factor, channels)
    sums, (count, size) = series(onwards, bounces), spread.shape[:2]
    basis, matrix = np.zeros((len(receivers), functions)), np.zeros((channels, count, functions, len(measured)))
    for n, box in enumerate(placed.boxes):
        rows = np.flatnonzero(lit == n)
        if not len(rows):
            continue
        light, arrives = blocks.entering[n]
        looked_up = observation(box, receivers[rows], dictionary.side)
        own = _own_light(box, receivers[rows], looked_up, blocks.within[n], blocks.implicit[n])
        q, r = np.linalg.qr(np.concatenate([own, *(looked_up @ each for each in light)], axis=1))
        here = np.eye(count)[n][:, None] * np.eye(size)[:, None]
        # [C, ·, N B]: light at the receivers on q, from the first bounce of every block
        caused = r @ np.concatenate([here.reshape(size, -1), *arrives]) @ sums
        likely = np.einsum("cqsb,sbp->qcsp", caused.reshape(*caused.shape[:2], count, size), spread, optimize=True)
        u, s, _ = factors(likely.reshape(len(r), -1))
        rank = min(functions, int(np.sum(s > _SMALL * s[0])))
        basis[rows, :rank] = q @ u[:, :rank]
        matrix[:, n, :rank] = (u[:, :rank].T @ caused) @ reading
    return Joined(basis, lit, matrix.reshape(channels, count * functions, -1))


def _between_bounces(
    placed: Placed, blocks: "_Blocks", measured: SurfacePoints, seen: Int[np.ndarray, " M"], samples: SurfacePoints,
    area: float, ridge_factor: float, channels: int,
) -> tuple[Float[np.ndarray, "C NB M"], Float[np.ndarray, "N B p"], Float[np.ndarray, "C NB NB"]]:  # fmt: skip
    """W ρ, from direct light at the points; b of the prior's light in each block; and R of each channel."""
    count, size, side = *blocks.read.shape[:2], round((blocks.read.shape[2] / FACES) ** 0.5)
    reading = np.zeros((channels, count, size, len(measured)))
    onwards = np.zeros((channels, count, size, count * size))
    spread = np.zeros((count, size, blocks.prior.shape[2]))
    near = placed.owner(samples)
    for n, box in enumerate(placed.boxes):
        rows, surface = np.flatnonzero(seen == n), samples[near == n]
        there = np.repeat(covered(box, surface.position, surface.normal, area), side * side)
        plausible = blocks.prior[n] * there[:, None]
        spread[n] = blocks.read[n] @ plausible
        first = _estimate(observation(box, measured[rows], side) @ plausible, spread[n], ridge_factor)
        reading[:, n][:, :, rows] = first * np.asarray(measured[rows].albedo[:, :channels], float).T[:, None]
        albedo = on_faces(observation(box, surface, side), np.asarray(surface.albedo[:, :channels], float))
        for c, reflected in enumerate((albedo * there[:, None]).T):
            reflects = blocks.read[n] * reflected
            onwards[c, n, :, n * size : (n + 1) * size] = reflects @ blocks.within[n]
            for light, arrives in zip(*blocks.entering[n], strict=True):
                onwards[c, n] += (reflects @ light) @ arrives
    return reading.reshape(channels, count * size, -1), spread, onwards.reshape(channels, count * size, -1)


def _operators(model: LevelTransfer) -> _Blocks:
    dictionary, kind, turns = model.dictionary, np.asarray(model.kind), np.asarray(model.turns)
    within, read, prior, arriving = (
        np.asarray(getattr(dictionary, name), np.float64) for name in ("basis", "read", "prior", "arriving")
    )
    implicit = prior @ np.linalg.pinv(read @ prior, _SMALL)
    solid, size = np.asarray(model.solid, np.float64), read.shape[1]
    count, rows = len(kind), arriving.shape[1]
    enters = np.asarray(model.enters)
    arrives = np.zeros((len(enters), rows, count * size))
    for to, source, pair in zip(*map(np.asarray, (model.pair_to, model.pair_from, model.pairs)), strict=True):
        arrives[to, :, source * size : (source + 1) * size] = pair
    back, there = turns[np.asarray(model.pose)], solid[:, :, None]
    light = arriving[turns[np.asarray(model.along)]] * there[enters]
    return _Blocks(
        np.stack([within[k][order] for k, order in zip(kind, back, strict=True)]) * there,
        np.stack([read[k][:, order] for k, order in zip(kind, back, strict=True)]) * solid[:, None],
        np.stack([prior[k][order] for k, order in zip(kind, back, strict=True)]) * there,
        np.stack([implicit[k][order] for k, order in zip(kind, back, strict=True)]) * there,
        [(light[enters == n], arrives[enters == n]) for n in range(count)],
    )


def _own_light(
    box: Box,
    points: SurfacePoints,
    looked_up: csr_array,
    within: Float[np.ndarray, "n B"],
    implicit: Float[np.ndarray, "n B"],
) -> Float[np.ndarray, "P B"]:
    """Light of a block's own surfaces at points: that of its faces where points lie on them, gathered from there elsewhere."""
    found, share = looked_up @ within, shares(points.normal)
    local, face = box.local(points.position), np.argmax(share, axis=1)
    away = 0.5 - np.where(face % 2 == 0, 1.0, -1.0) * local[np.arange(len(face)), face // 2]
    inside = (away > _ON_FACE) | (share.max(axis=1) < 1.0 - _ON_FACE)
    found[inside] = received(box, points[inside], implicit, round((len(within) / FACES) ** 0.5))
    return found


def _estimate(
    seen: Float[np.ndarray, "M p"], wanted: Float[np.ndarray, "B p"], factor: float
) -> Float[np.ndarray, "B M"]:
    """The best linear estimate of what the prior has at `wanted` from what it has at the points, a ridge regression."""
    if not len(seen):
        return np.zeros((len(wanted), 0))
    spare = -len(seen) % 64  # points without light change nothing, and few shapes are compiled
    damping = factor * np.sum(seen**2) / max(len(seen), 1)
    padded: Array = jnp.pad(jnp.asarray(seen), ((0, spare), (0, 0)))
    return np.asarray(ridge(padded, jnp.asarray(wanted), jnp.asarray(damping)))[:, : len(seen)]
