"""What training minimises: squared errors that neither scale nor darkness can spoil. No network and no optimiser here."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

FLOOR = 0.1
"""Least denominator of a relative error, as a share of the root mean square of the targets it is among."""


def square(prediction: Float[Array, "*s"], target: Float[Array, "*s"]) -> Float[Array, ""]:
    """Mean squared error."""
    return jnp.mean((prediction - target) ** 2)


def relative_square(
    prediction: Float[Array, "*s k"], target: Float[Array, "*s k"], size: float | Float[Array, ""] = 1.0
) -> Float[Array, ""]:
    """Mean of |p − t|² / max(|t|², |p|², f²) over vectors of k numbers, f = `FLOOR` · `size` · √k: a tenth weighs the same in
    light and in shade.

    `size` is the root mean square of what the targets are drawn from. The denominator is held constant in the derivative
    (Lehtinen et al. 2018) and never falls below the floor, so neither a dark target nor a prediction of 0 divides by 0.
    """
    k = target.shape[-1]
    floor = FLOOR**2 * k * jnp.asarray(size, target.dtype) ** 2
    floor = jnp.where(floor > 0, floor, 1.0)  # nothing but darkness
    largest = jnp.maximum(jnp.sum(target**2, axis=-1), jnp.sum(prediction**2, axis=-1))
    largest = jax.lax.stop_gradient(jnp.maximum(largest, floor))
    return jnp.mean(jnp.sum((prediction - target) ** 2, axis=-1) / largest)


def power_of_two(size: float | Float[Array, "*s"]) -> Float[Array, "*s"]:
    """The power of two next below `size`, and 1 where that is 0 or not finite: divided by it, light keeps all its digits."""
    size = jnp.asarray(size)
    usable = (size > 0) & jnp.isfinite(size)
    _, exponent = jnp.frexp(jnp.where(usable, size, 1.0))
    return jnp.where(usable, jnp.ldexp(jnp.ones_like(size), exponent - 1), 1.0)
