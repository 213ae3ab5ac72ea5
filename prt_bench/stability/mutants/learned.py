"""Naive training: division by dark light, sizes left in, every update taken, a rectifier that is not homogeneous."""

from typing import Any

import jax.numpy as jnp

from prt_bench.stability.mutants import mutant

_LOSS = "prt_bench.learned.losses:relative_square"


@mutant("a relative loss without a floor", _LOSS, "relative loss of dark", "derivative of a relative")
def unfloored(_: Any) -> Any:
    """0 / 0 at the first dark texel."""
    return lambda prediction, target, size=1.0: jnp.mean(
        jnp.sum((prediction - target) ** 2, axis=-1) / jnp.sum(target**2, axis=-1)
    )


@mutant("a floor in watts", _LOSS, "relative loss of dark", "derivative of a relative")
def absolute_floor(_: Any) -> Any:
    """Faint light is divided by next to nothing, and tells by how much of a unit it was measured in."""
    return lambda prediction, target, size=1.0: jnp.mean(
        jnp.sum((prediction - target) ** 2, axis=-1) / (jnp.sum(target**2, axis=-1) ** 2 + 1e-8)
    )


@mutant("a denominator that is differentiated", _LOSS, "derivative of a relative")
def moving_denominator(_: Any) -> Any:
    """A prediction too bright is drawn to infinity as well as to its target."""

    def naive(prediction: Any, target: Any, size: Any = 1.0) -> Any:
        floor = jnp.where(size > 0, 0.01 * jnp.asarray(size) ** 2, 1.0)
        return jnp.mean(jnp.sum((prediction - target) ** 2, axis=-1) / (jnp.sum(prediction**2, axis=-1) + floor))

    return naive


@mutant("targets as they come", "prt_bench.learned.losses:power_of_two", "targets of extreme")
def unscaled(_: Any) -> Any:
    """Adam's steps have a size of their own, and squares of large light none that float32 can hold."""
    return lambda size: jnp.ones_like(jnp.asarray(size))


@mutant("every update taken", "prt_bench.learned.training:finite", "one update that")
def unguarded(_: Any) -> Any:
    """One NaN, and Adam remembers nothing else."""
    return lambda tree: jnp.asarray(True)


@mutant("moments of a bad update kept", "prt_bench.learned.training:keep", "one update that")
def half_guarded(sound: Any) -> Any:
    """The weights are spared, the moments are not."""
    return lambda good, new, old: (sound(good, new[0], old[0]), new[1])
