"""Gradients against central differences along random directions, kinks told from errors."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.stability.cell import Measured
from prt_bench.stability.routes import Route

_STEPS = {np.float64: 1e-6, np.float32: 2e-3}


def gradient_error(
    function: Callable[..., jax.Array],
    arguments: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    route: Route,
) -> Iterator[Measured]:
    """One `Measured` per argument: the slope along its direction against differences, relative to gradient and direction.

    `function` takes arrays of the route's dtype and is weighted at random into a scalar in float64. The points that are
    compared are those that the dtype holds, so only the curvature limits the step.
    """
    rng = np.random.default_rng(11)
    here = [jnp.asarray(argument, route.compute) for argument in arguments]
    shape = jax.eval_shape(function, *here).shape
    weight = rng.normal(size=shape)

    def loss(*arguments: jax.Array) -> jax.Array:
        return jnp.sum(weight * function(*arguments).astype(jnp.float64))

    slopes = jax.grad(loss, argnums=tuple(range(len(here))))(*here)
    for index, (slope, direction) in enumerate(zip(slopes, directions, strict=True)):
        yield _compare(loss, here, index, np.asarray(slope, np.float64), np.asarray(direction), route)


def _compare(
    loss: Callable[..., jax.Array], arguments: list, index: int, slope: np.ndarray, direction: np.ndarray, route: Route
) -> Measured:
    if not np.all(np.isfinite(slope)):
        return Measured(np.nan, route.gradient_tolerance)
    here = arguments[index]
    step = _STEPS[route.compute]

    def at(size: float) -> tuple[float, Any]:
        place = jnp.asarray(np.asarray(here, np.float64) + size * direction, route.compute)
        moved = np.asarray(place, np.float64) - np.asarray(here, np.float64)
        return float(loss(*arguments[:index], place, *arguments[index + 1 :])), moved

    # Richardson's extrapolation of two central differences leaves an error of fourth order.
    quotients = []
    for size in (step, 2 * step):
        (ahead, forward), (behind, backward) = at(size), at(-size)
        quotients.append((ahead - behind) / size - np.sum(slope * (forward - backward)) / size)
    gap = abs(4 * quotients[0] - quotients[1]) / 3 / 2
    scale = np.linalg.norm(slope) * np.linalg.norm(direction)
    return Measured(gap / scale if scale > 0 else gap, route.gradient_tolerance)
