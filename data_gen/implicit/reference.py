"""Transfer vectors by following paths: the reference of the bake and of what is fitted to it.

Directions are plain random numbers, every path goes on from its own hit, and no table, sample or operator is shared.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from prt_bench.implicit.expression import in_few_sizes
from prt_bench.implicit.scene import ImplicitScene
from prt_bench.implicit.tracing import trace
from prt_bench.spherical import evaluate


class Followed(NamedTuple):
    """Mean transfer [P, 1 + C, K] in steradians, direct then all light by channel, and its standard error [P, 1 + C, K]."""

    mean: Float[np.ndarray, "P W K"]
    error: Float[np.ndarray, "P W K"]


def follow(
    scene: ImplicitScene,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    order: int,
    paths: int = 256,
    bounces: int = 8,
    seed: int = 0,
) -> Followed:
    """Follow `paths` paths from each point through up to `bounces` diffuse reflections; K = order².

    A path that escapes after n of them adds π times what it was reflected of every harmonic of its last direction. What
    `bounces` cuts off is at most the largest albedo to that power.
    """
    rng = np.random.default_rng(seed)
    points, channels = len(position), 1 if scene.achromatic else 3
    place, facing = (np.repeat(np.asarray(each, float), paths, axis=0) for each in (position, normal))
    kept = np.ones((len(place), 1 + channels))
    alive = np.arange(len(place))
    total = np.zeros((len(place), 1 + channels, order * order), np.float32)
    for bounce in range(bounces + 1):
        direction = _cosine(rng, facing)
        found = trace(scene, place, direction, offset=True)
        gone = alive[~found.hit]
        harmonics = in_few_sizes(_harmonics, order, direction[~found.hit])
        total[gone] += (np.pi * kept[~found.hit, :, None] * harmonics[:, None]).astype(np.float32)
        place = place[found.hit] + found.distance[found.hit, None] * direction[found.hit]
        if bounce == bounces or not len(place):
            break
        alive, facing = alive[found.hit], scene.normal_at(place)
        albedo = scene.albedos[scene.part_at(place)][:, :channels]
        kept = kept[found.hit] * np.hstack([np.zeros((len(place), 1)), albedo])
    total = total.reshape(points, paths, 1 + channels, -1)
    return Followed(total.mean(axis=1), total.std(axis=1) / np.sqrt(max(paths - 1, 1)))


def _harmonics(order: int, direction: Float[Array, "n 3"]) -> Float[Array, "n K"]:
    return evaluate(direction, order)


def _cosine(rng: np.random.Generator, normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Directions whose density is the cosine with the normal: the normal plus a point of the unit sphere."""
    drawn = rng.normal(size=normal.shape)
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    away = normal + drawn
    return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
