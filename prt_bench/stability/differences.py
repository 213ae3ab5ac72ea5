"""Gradients against central differences along given directions."""

from collections.abc import Callable, Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.stability.cell import Measured
from prt_bench.stability.routes import Route

_STEPS = (1e-4, 1e-5, 1e-3, 1e-2)
"""Short for functions that bend, as a basis whose next singular value is near, long for those that have float32 inside; a
right gradient matches one of them."""


def gradient_error(
    function: Callable[..., jax.Array],
    arguments: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    route: Route,
) -> Iterator[Measured]:
    """One `Measured` per argument: the slope along its direction against differences.

    The gradient is the route's; the differences are taken of the same function in float64, with Richardson's extrapolation,
    so that they are good to ten digits. `function` is weighted at random into a scalar. The error is relative to the larger
    of the slope and what a loss of this size changes by when the argument changes by all of itself.
    """
    here = [jnp.asarray(argument, route.compute) for argument in arguments]
    precise = [jnp.asarray(argument, jnp.float64) for argument in here]
    value = np.asarray(function(*precise))
    weight = np.random.default_rng(11).normal(size=value.shape)

    def loss(*arguments: jax.Array) -> jax.Array:
        return jnp.sum(weight * function(*arguments).astype(jnp.float64))

    slopes = jax.grad(loss, argnums=tuple(range(len(here))))(*here)
    for index, (slope, direction) in enumerate(zip(slopes, directions, strict=True)):
        slope, direction = np.asarray(slope, np.float64), np.asarray(direction, np.float64)
        if not np.all(np.isfinite(slope)):
            yield Measured(np.nan, route.gradient_tolerance)
            continue
        size = np.linalg.norm(direction) / (float(np.linalg.norm(precise[index])) or 1.0)
        scale = max(np.linalg.norm(slope) * np.linalg.norm(direction), np.linalg.norm(weight * value) * size)
        error = np.inf
        for step in _STEPS:
            gap = abs(np.sum(slope * direction) - _difference(loss, precise, index, direction, step))
            error = min(error, float(gap / (scale or 1.0)))
            if error <= route.gradient_tolerance:
                break
        yield Measured(error, route.gradient_tolerance)


def _difference(
    loss: Callable[..., jax.Array], at: list[jax.Array], index: int, direction: np.ndarray, step: float
) -> float:
    """Derivative of the loss along a direction: two central differences, extrapolated to an error of fourth order."""

    def quotient(step: float) -> float:
        ahead, behind = (
            float(loss(*at[:index], at[index] + sign * step * direction, *at[index + 1 :])) for sign in (1, -1)
        )
        return (ahead - behind) / (2 * step)

    return (4 * quotient(step) - quotient(2 * step)) / 3
