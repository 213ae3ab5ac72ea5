"""Gradient descent as the experiments on inverse problems share it: Adam with a falling step, in chunks under one `jit`."""

from collections.abc import Callable
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
    visibility. Updates that are not finite are left out.
    """
    chunk = every or steps
    rule = optax.apply_if_finite(optax.adam(optax.cosine_decay_schedule(rate, steps, 0.01)), steps)

    @jax.jit
    def some(parameters: Any, state: Any, given: Any) -> tuple[Any, Any]:
        def one(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
            at, state = carry
            updates, state = rule.update(jax.grad(loss)(at, given), state, at)
            return (optax.apply_updates(at, updates), state), None

        return jax.lax.scan(one, (parameters, state), None, length=chunk)[0]

    at = jax.tree.map(jnp.asarray, start)
    state = rule.init(at)
    for _ in range(0, steps, chunk):
        at, state = some(at, state, data(at))
    return at
