"""Derivatives of predictions through whole fits: in measured light, in the training data, and in the ridge."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.methods.base import Method
from prt_bench.stability import rigs
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.rigs import Rig, relit, subjects
from prt_bench.stability.routes import Route

_RIDGE = 0.03


def _rigs(route: Route) -> Iterator[Member]:
    return (member for member in rigs.rigs(route) if not member.ill_posed)


@case("C5", "prediction in measured light", kind=Kind.GRADIENT, subjects=subjects, family=_rigs)
def in_measured_light(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """C5, H1: against differences under light, and finite in the dark."""
    model = method.fit(rig.train)
    x = np.asarray(model.measure(rig.test))[:3]

    def predict(x: jax.Array) -> jax.Array:
        return model.reconstruct(model.transfer(x.astype(jnp.float64)))

    direction = np.random.default_rng(0).normal(size=x.shape) * x
    yield from gradient_error(predict, [x], [direction], route)
    dark = jax.grad(lambda x: jnp.sum(predict(x)))(jnp.zeros(x.shape, x.dtype))
    yield Measured(0.0 if bool(jnp.all(jnp.isfinite(dark))) else np.nan, 1.0)


def _smooth_in_data() -> dict[str, Method]:
    """Floors that choose one of the training lightings jump where two are equally near; the others must not, but for those
    that refuse derivatives."""
    found = subjects(ridge=_RIDGE)
    return {label: method for label, method in found.items() if method.differentiable and method.name != "nearest"}


@case("H1", "prediction in the training data", kind=Kind.GRADIENT, subjects=_smooth_in_data, family=_rigs)
def in_training_data(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """H1, B4, A6: through normalisation, mean, basis and ridge, on duplicates, darkness, symmetry and missing rank."""

    def predict(measured: jax.Array, indirect: jax.Array) -> jax.Array:
        return method.fit(relit(rig.train, measured, indirect)).predict(rig.test)  # pyright: ignore[reportArgumentType]

    return gradient_error(predict, [rig.train.measured, rig.train.indirect], rig.tangent, route)


def _trained() -> dict[str, Method]:
    return {label: method for label, method in subjects().items() if not method.differentiable}


@case("H1", "derivatives through training", kind=Kind.REFUSAL, subjects=_trained, family=_rigs)
def through_training(method: Method, rig: Rig, route: Route) -> bool:
    """H1: what trains by gradient steps does not pass off the derivative of something else as that of its fit."""
    light = jnp.asarray(rig.train.measured), jnp.asarray(rig.train.indirect)
    jax.grad(lambda x: jnp.sum(method.fit(relit(rig.train, x, light[1])).predict(rig.test)))(light[0])  # pyright: ignore[reportArgumentType]
    return False


def _with_ridge() -> dict[str, Method]:
    return {label: method for label, method in subjects().items() if "ridge" in rigs.settings(method)}


@case("H1", "prediction in the ridge", kind=Kind.GRADIENT, subjects=_with_ridge, family=_rigs)
def in_ridge(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """H1: by implicit differentiation of the normal equations."""

    def predict(factor: jax.Array) -> jax.Array:
        return method.with_traced(ridge=factor).fit(rig.train).predict(rig.test)

    return gradient_error(predict, [np.array(_RIDGE)], [np.array(_RIDGE)], route)
