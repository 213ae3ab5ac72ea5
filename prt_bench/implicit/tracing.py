"""Sphere tracing: the first point of a ray where the distance is as good as 0.

Steps of |d| / slope cannot cross the surface. Nothing is differentiated here; a hit is a place, and what holds there is.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from prt_bench.implicit.expression import Distance, distances, in_few_sizes, padded_size
from prt_bench.implicit.scene import OFFSET, ImplicitScene

STEPS = 256
"""After as many a ray that creeps along a surface has hit it where it is within `CREEPING` hit tolerances, else escaped: rays
that leave a surface under a flat angle begin farther away than that."""
CREEPING = 2.0
_PHASE = 16
MARGIN = 8.0
"""By how many hit tolerances rays go on beyond the scene's box."""
_BATCH = 1 << 16


class RayHits(NamedTuple):
    """Distance [n] along each ray, in lengths of its direction, and whether it hit; where not, the distance has no meaning."""

    distance: Float[np.ndarray, " n"]
    hit: Bool[np.ndarray, " n"]


def trace(
    scene: ImplicitScene, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], offset: bool = False
) -> RayHits:
    """First hits of rays with unit directions, in float32.

    Rays that begin outside of the scene's box enter it first, and leave at its other side. With `offset` they begin at
    points on the surface, and leave those by `OFFSET` hit tolerances along the direction that leads away from it fastest.
    """
    origins, directions = np.asarray(origins, np.float32), np.asarray(directions, np.float32)
    if offset:
        step = np.float32(OFFSET * scene.tolerance)
        origins = (origins + step * np.asarray(scene.normal_at(origins), np.float32)).astype(np.float32)
    parts = [
        _trace(scene, origins[at : at + _BATCH], directions[at : at + _BATCH])
        for at in range(0, max(len(origins), 1), _BATCH)
    ]
    return RayHits(np.concatenate([part.distance for part in parts]), np.concatenate([part.hit for part in parts]))


def _trace(scene: ImplicitScene, origins: np.ndarray, directions: np.ndarray) -> RayHits:
    near, far = through(scene, origins, directions)
    distance, hit = near.copy(), np.zeros(len(origins), bool)
    active = np.flatnonzero(near < far)
    shape, numbers = scene.shape, (np.float32(scene.tolerance), np.float32(1.0 / scene.shape.slope))
    for _ in range(0, STEPS, _PHASE):
        if not active.size:
            break
        rows = np.resize(active, padded_size(len(active)))
        t, met = _march(shape, origins[rows], directions[rows], distance[rows], far[rows], *numbers)
        distance[active], hit[active] = np.asarray(t)[: len(active)], np.asarray(met)[: len(active)]
        active = active[~hit[active] & (distance[active] < far[active])]
    if active.size:
        ends = origins[active] + distance[active, None] * directions[active]
        hit[active] = in_few_sizes(distances, shape, ends) < CREEPING * scene.tolerance
    return RayHits(distance, hit)


@eqx.filter_jit
def _march(
    shape: Distance, origin: Array, direction: Array, start: Array, far: Array, tolerance: Array, share: Array
) -> tuple[Array, Array]:
    def step(_: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        t, met = state
        d = shape(origin + t[:, None] * direction)
        ended = met | (t >= far)
        met = met | (~ended & (d < tolerance))
        return jnp.where(ended | met, t, t + share * d), met

    return jax.lax.fori_loop(0, _PHASE, step, (start, jnp.zeros(len(start), bool)))


def through(scene: ImplicitScene, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter and leave the scene's box, widened by a few hit tolerances; entered at 0 from within."""
    low, high = scene.bounds + MARGIN * scene.tolerance * np.array([[-1.0], [1.0]])
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (low.astype(np.float32) - origins) / directions
        b = (high.astype(np.float32) - origins) / directions
    near = np.nanmax(np.minimum(a, b), axis=1, initial=0.0)
    far = np.nanmin(np.maximum(a, b), axis=1, initial=np.inf)
    return near.astype(np.float32), far.astype(np.float32)


def crossings(
    scene: ImplicitScene, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], most: int = 32
) -> Float[np.ndarray, "P 3"]:
    """All points where lines cross the surface inside the scene's box, up to `most` of each, line after line.

    Lines are followed inside the solid too; where d touches 0 without a change of sign, nothing is crossed. Points lie on
    the zero set to float32's rounding of the coordinates, by bisection.
    """
    near, far = (array.astype(np.float64) for array in through(scene, origins, directions))
    found: list[np.ndarray] = []
    owner: list[np.ndarray] = []
    active, t = np.flatnonzero(near < far), near.copy()
    step = OFFSET * scene.tolerance
    follow = partial(_cross, scene.shape, scene.tolerance, 1.0 / scene.shape.slope)
    for _ in range(most):
        if not active.size:
            break
        rows = np.resize(active, padded_size(len(active)))
        root, after, crossed = (
            np.asarray(part)[: len(active)]
            for part in follow(origins[rows], directions[rows], t[rows], far[rows], step)
        )
        place = origins[active] + root[:, None] * directions[active]
        found.append(place[crossed])
        owner.append(active[crossed])
        t[active] = after
        active = active[after < far[active]]
    if not found:
        return np.zeros((0, 3))
    order = np.argsort(np.concatenate(owner), kind="stable")
    return np.concatenate(found)[order]


@partial(eqx.filter_jit, donate="none")
def _cross(
    shape: Distance,
    tolerance: float,
    share: float,
    origin: Array,
    direction: Array,
    start: Array,
    far: Array,
    step: float,
) -> tuple[Array, Array, Array]:
    """Follow |d| to the next touch, step over it, and bisect where the sign changed."""

    def at(t: Array) -> Array:
        return shape(origin + t[:, None] * direction)

    def ahead(state: tuple[Array, Array]) -> tuple[Array, Array]:
        t, count = state
        d = jnp.abs(at(t))
        return jnp.where((d < tolerance) | (t >= far), t, t + share * d), count + 1

    def going(state: tuple[Array, Array]) -> Array:
        t, count = state
        return (count < STEPS) & jnp.any((jnp.abs(at(t)) >= tolerance) & (t < far))

    t, _ = jax.lax.while_loop(going, ahead, (start, jnp.zeros((), int)))
    before, after = jnp.maximum(t - step, start), t + step
    crossed = (t < far) & (at(before) * at(after) < 0)
    return _bisected(at, before, after), after, crossed


def _bisected(at: Callable[[Array], Array], low: Array, high: Array) -> Array:
    side = at(low) > 0

    def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        a, b = ends
        middle = 0.5 * (a + b)
        same = (at(middle) > 0) == side
        return jnp.where(same, middle, a), jnp.where(same, b, middle)

    return jax.lax.fori_loop(0, 30, halve, (low, high))[0]
