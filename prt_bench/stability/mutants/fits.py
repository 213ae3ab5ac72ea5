"""Naive fits: one side normalised or centred, darkness divided by, channels mixed, warnings left out."""

from typing import Any

import jax.numpy as jnp

from prt_bench.stability.mutants import mutant
from prt_bench.stability.routes import F64

_METHOD = "svd-ridge"
_NORMALISED = "prt_bench.methods.examples:normalised"


@mutant("nothing normalised", _NORMALISED, "intensities of twelve", subject=_METHOD)
def unnormalised(sound: Any) -> Any:
    """The brightest lighting rules the fit."""

    def naive(measured: Any, indirect: Any, by: str = "indirect") -> Any:
        found = sound(measured, indirect, by)
        x, y = (jnp.moveaxis(light.astype(float), 1, 0).reshape(light.shape[1], -1) for light in (measured, indirect))
        return found._replace(x=x, y=y, norm=jnp.linalg.norm(x, axis=0))

    return naive


@mutant("one side normalised", _NORMALISED, "error near the projection", subject=_METHOD)
def half_normalised(sound: Any) -> Any:
    """The two sides are no longer the same map."""

    def naive(measured: Any, indirect: Any, by: str = "indirect") -> Any:
        y = jnp.moveaxis(indirect.astype(float), 1, 0).reshape(indirect.shape[1], -1)
        return sound(measured, indirect, by)._replace(y=y)

    return naive


@mutant("one side centred", "prt_bench.methods.examples:Examples.less", "error near the projection", subject=_METHOD)
def half_centred(_: Any) -> Any:
    """The mean is fitted twice."""
    return lambda self, x, y: self._replace(y=self.y - y * self.norm)


@mutant("division by dark light", _NORMALISED, "black lightings", subject=_METHOD)
def divided_by_darkness(sound: Any) -> Any:
    """0 / 0 in every basis function."""

    def naive(measured: Any, indirect: Any, by: str = "indirect") -> Any:
        found = sound(measured, indirect, by)
        size = jnp.linalg.norm(found.x, axis=0)
        return found._replace(x=found.x / size * size, y=found.y / size * size)

    return naive


@mutant("a floor added to the norm", _NORMALISED, "unit of light", subject=_METHOD)
def floored_norm(sound: Any) -> Any:
    """Avoids 0 / 0, and brings in a unit."""

    def naive(measured: Any, indirect: Any, by: str = "indirect") -> Any:
        found = sound(measured, indirect, by)
        x = jnp.moveaxis(measured.astype(float), 1, 0).reshape(measured.shape[1], -1)
        weight = jnp.linalg.norm(x, axis=0) / (jnp.linalg.norm(x, axis=0) + 1e-2)
        return found._replace(x=found.x * weight, y=found.y * weight, norm=found.norm * weight)

    return naive


@mutant("columns in float32", "prt_bench.methods.examples:columns", "error near the projection", subject=_METHOD)
def columns_in_float32(sound: Any) -> Any:
    """A float32 fit, shipped as if it were better."""
    return lambda light: sound(light).astype(jnp.float32).astype(jnp.float64)


@mutant("NaN let through", "prt_bench.methods.examples:training_light", "no light, NaN", subject=_METHOD)
def unchecked(_: Any) -> Any:
    """A model of NaN, without a word."""
    return lambda ds: (jnp.asarray(ds.measured), jnp.asarray(ds.indirect))


@mutant(
    "warnings left out", "prt_bench.methods.linear:warn_of_rank", "more functions", "a cut through", subject=_METHOD
)
def unwarned(_: Any) -> Any:
    """Empty and arbitrary functions go out without a word."""
    return lambda label, model: None


@mutant("channels mixed", "prt_bench.models:LinearModel.transfer", "white light", subject=_METHOD)
def mixed_channels(sound: Any) -> Any:
    """Learns from white light that colours go together."""
    return lambda self, x: sound(self, jnp.broadcast_to(jnp.mean(x, axis=2, keepdims=True), x.shape))


@mutant("norm with NaN gradient in the model", "prt_bench.linalg:safe_norm", "prediction in measured", subject=_METHOD)
def model_norm(_: Any) -> Any:
    """The derivative of a square root in the dark."""
    return lambda x, axis: jnp.linalg.norm(x, axis=axis, keepdims=True)


@mutant("a light behind the model", "prt_bench.models:LinearModel.transfer", "f(a x)", subject=_METHOD, routes=(F64,))
def affine(sound: Any) -> Any:
    """An affine model glows in the dark."""
    return lambda self, x: sound(self, x) + 1e-3
