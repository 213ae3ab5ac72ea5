"""Gradient descent as the experiments on inverse problems share it: Adam with a falling step, in chunks under one `jit`."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import optax


def descend(
    loss: Callable[[Any, Any], jax.Array],
    start: Any,
    steps: int,
    rate: float,
    data: Callable[[Any], Any] = lambda _: None,
    every: int = 0,
) -> Any:
    """Where `steps` steps of Adam on `loss(parameters, data)` lead, the rate falling to a hundredth by a cosine.

    `data` is computed anew before each `every` steps (0: once), outside of JAX: what gradients do not reach, such as
    visibility. Updates that are not finite are left out. The same `loss` is compiled once, however often it is descended.
    """
    rule, chunk = _adam(steps, rate), every or steps
    at = jax.tree.map(jnp.asarray, start)
    state = rule.init(at)
    for _ in range(0, steps, chunk):
        at, state = _some(loss, rule, chunk, at, state, data(at))
    return at


@lru_cache
def _adam(steps: int, rate: float) -> optax.GradientTransformation:
    return optax.apply_if_finite(optax.adam(optax.cosine_decay_schedule(rate, steps, 0.01)), steps)


@partial(jax.jit, static_argnames=("loss", "rule", "count"))
def _some(
    loss: Callable[[Any, Any], jax.Array],
    rule: optax.GradientTransformation,
    count: int,
    parameters: Any,
    state: Any,
    given: Any,
) -> tuple[Any, Any]:
    def one(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
        at, state = carry
        updates, state = rule.update(jax.grad(loss)(at, given), state, at)
        return (optax.apply_updates(at, updates), state), None

    return jax.lax.scan(one, (parameters, state), None, length=count)[0]
