"""The light that models learn from: streamed lightings and light never seen to train on, the training split to validate on.

Direct light becomes coefficients of the light it causes through the operator's adjoint, so examples need no bake. What was
baked of the training split is never trained on and says when to stop.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.errors import FitError
from prt_bench.linalg import safe_norm
from prt_bench.methods.examples import column_scale, training_light
from prt_bench.methods.operator import coefficients, fit_albedo, importance, streamed_blocks
from prt_bench.methods.prior import prior_columns


class Light(NamedTuple):
    """Examples over the size of their indirect light: measured x [n, M, W] and coefficients [n, K, C] of what it causes.

    W is 1 for streamed lightings, which are grey, or C. In float64; a lighting that causes nothing is 0 in both.
    """

    x: Float[Array, "n M W"]
    targets: Float[Array, "n K C"]


def refuse_derivatives(name: str, ds: LightingDataset) -> None:
    """Raise `FitError` where the light is traced: nobody should take the derivative of a training for one of the fit."""
    if isinstance(ds.measured, Tracer) or isinstance(ds.indirect, Tracer):
        raise FitError(
            f"{name} trains by gradient steps, and derivatives of what it predicts in its training light are not offered;"
            " differentiate the method it starts from"
        )


def training_examples(ds: LightingDataset, columns: Float[Array, "T K"]) -> Light:
    """The streamed lightings of `ds`, then half as many of `surface_light`, with coefficients on orthonormal `columns`.

    Raises `DatasetError` for a dataset without streamed lightings.
    """
    adjoint = importance(ds.transport, fit_albedo(ds), columns)
    found = jnp.concatenate([coefficients(adjoint, direct) for _, direct in streamed_blocks(ds)], axis=2)
    further = surface_light(ds, ds.streamed.measured.shape[0] // 2)
    patterns = prior_columns(ds, "surface")
    answers = jnp.einsum("ckp,pn->ckn", coefficients(adjoint, patterns.direct), further.T, precision="highest")
    x = jnp.concatenate([jnp.asarray(ds.streamed.measured, jnp.float64), further @ patterns.measured.T])
    targets = jnp.concatenate([found, answers], axis=2)
    return _sized(x[:, :, None], jnp.moveaxis(targets, 2, 0), len(columns))


def surface_light(ds: LightingDataset, count: int) -> Float[np.ndarray, "n P"]:
    """Weights of the "surface" patterns of `prior_columns` for smooth light that no lighting of the scenario need resemble.

    max(0, a · p + b · n + c) of position p and normal n with a, b, c drawn at random: light that falls from one side, rises
    across the scene, or is even. It keeps a network honest for light from far away when the scenario is lamps nearby.
    """
    points = ds.measurement_points
    position = points.position - points.position.mean(axis=0)
    place = np.hstack([position / max(float(position.std()), np.finfo(float).tiny), points.normal])
    drawn = np.random.default_rng(0).normal(size=(count, 7))
    return np.maximum(drawn[:, :6] @ place.T + drawn[:, 6:], 0.0)


@jax.jit
def _sized(x: Float[Array, "n M 1"], targets: Float[Array, "n C K"], receivers: int) -> Light:
    """Every lighting over one size for all its channels, whose brightness belongs together."""
    flat = targets.reshape(len(targets), -1)
    size = safe_norm(flat, axis=1) / targets.shape[1] ** 0.5
    scale, _ = column_scale(x[:, :, 0].T, size.T, receivers, "indirect")
    scale = scale.T[:, :, None]
    return Light(x * scale, jnp.swapaxes(targets, 1, 2) * scale)


def held_light(ds: LightingDataset, columns: Float[Array, "T K"]) -> Light:
    """The training split likewise, each channel over a size of its own. Raises `FitError` as closed-form fits do."""
    measured, indirect = training_light(ds)
    return _held(measured, indirect, columns)


@jax.jit
def _held(measured: Float[Array, "N M C"], indirect: Float[Array, "N T C"], columns: Float[Array, "T K"]) -> Light:
    x, y = measured.astype(jnp.float64), indirect.astype(jnp.float64)
    lightings, receivers, channels = y.shape
    size = safe_norm(y, axis=1)
    scale, _ = column_scale(jnp.moveaxis(x, 1, 0).reshape(x.shape[1], -1), size.reshape(1, -1), receivers, "indirect")
    scale = scale.reshape(lightings, 1, channels)
    return Light(x * scale, jnp.einsum("tk,ntc->nkc", columns, y * scale, precision="highest"))


def in_float32(light: Light) -> Light:
    """What training computes with."""
    return Light(*(jnp.asarray(part, jnp.float32) for part in light))


def any_order_mean(errors: Float[Array, " n"]) -> Float[Array, ""]:
    """The mean whose bits do not depend on the order of the lightings, nor on black ones but for the count.

    Sorting first makes which weights are best a matter of the lightings alone.
    """
    return jnp.sum(jnp.sort(errors)) / jnp.maximum(jnp.sum(errors > 0), 1)
