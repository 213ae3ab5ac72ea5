"""Reduced-rank regression: the best linear map of a given rank, where `svd-ridge` fixes its basis before it regresses."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.linalg import leading_basis, rounding_floor, svd
from prt_bench.methods.base import Method
from prt_bench.methods.examples import Examples, normalised, training_light
from prt_bench.methods.linear import linear_model, warn_of_rank
from prt_bench.methods.operator import coefficients, fit_albedo, importance, respond, streamed_blocks
from prt_bench.methods.operator_ridge import RIDGES, Auto
from prt_bench.methods.prior import Columns, Kind, prior_columns, scale
from prt_bench.models import LinearModel

_PROBES = 32  # random vectors that tell the size of a lighting's indirect light to an eighth


@dataclass(frozen=True)
class ReducedRank(Method):
    """u = Uᵀ W x with W = 𝒮 Σ Aᵀ (A Σ Aᵀ + λ)⁻¹, and U the principal components of W x instead of those of the indirect light.

    They hold what can be told from the measured light, where components of the light itself hold what varies, told or not;
    no map of rank B comes closer to the streamed lightings as λ → 0. Σ is their covariance, each over the size of its
    indirect light, with a share `prior` of surface patterns as in `operator-ridge`; U is of the lightings alone. `ridge` is
    relative to the trace; "auto" takes the one with the least error of W on the training lightings. The map is linear. The
    dataset must be baked with `streamed` lightings.
    """

    name: ClassVar[str] = "reduced-rank"
    summary: ClassVar[str] = "the best linear map of rank B for thousands of lightings streamed through the operator"
    citation: ClassVar[str] = "izenman1975reducedrank, with the covariance of the streamed direct light"

    basis: int = 16
    ridge: float | Auto = "auto"
    prior: float = 0.02
    patterns: Kind = "cells"

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(self.ridge == "auto" or 0 < self.ridge < float("inf"), "ridge", "positive or 'auto'")
        self.require(0 <= self.prior <= 1, "prior", "from 0 to 1")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> LinearModel:
        """Fit in closed form; needs the transport and the streamed lightings of `ds`."""
        examples = normalised(*training_light(ds))
        factors = _factors(ds, prior_columns(ds, self.patterns), self.prior)
        ridges = jnp.asarray(RIDGES if self.ridge == "auto" else (self.ridge,))
        damping = ridges * jnp.sum(factors.s**2) / len(factors.p)
        if len(ridges) > 1:
            damping = damping[jnp.argmin(jnp.stack([_error(factors, examples, value) for value in damping]))]
        model = linear_model(*_reduced(factors, damping.reshape(()), self.basis))
        warn_of_rank(self.label, model)
        return model


class _Factors(NamedTuple):
    """W = `response` · diag(s / (s² + λ)) · pᵀ in each channel, and a square root of the lightings' own A Σ Aᵀ."""

    p: Float[Array, "M M"]
    s: Float[Array, " M"]
    response: Float[np.ndarray, "T C M"]
    root: Float[Array, "M k"]

    def after(self, damping: Array) -> Float[Array, "M M"]:
        """diag(s / (s² + λ)) · pᵀ."""
        return (self.s / (self.s**2 + damping))[:, None] * self.p.T


def _factors(ds: LightingDataset, patterns: Columns, share: float) -> _Factors:
    albedo = fit_albedo(ds)
    weight = streamed_weights(ds, albedo)
    x = ds.streamed.measured.T * weight
    of_lightings, of_patterns = float(scale(1.0 - share, x)), float(scale(share, patterns.measured))
    p, s, qt = jax.jit(svd)(jnp.concatenate([of_lightings * x, of_patterns * patterns.measured], axis=1))
    q = np.asarray(qt.T, np.float32)
    lightings, rest = q[: x.shape[1]] * (of_lightings * weight[:, None]), q[x.shape[1] :]
    direct = of_patterns * patterns.direct @ rest
    for rows, light in streamed_blocks(ds):
        direct += light @ lightings[rows]
    root = jnp.linalg.qr(jnp.asarray(of_lightings * x.T, jnp.float64), mode="r").T
    return _Factors(p, s, respond(ds.transport, albedo, direct.astype(np.float32)), root)


def streamed_weights(ds: LightingDataset, albedo: Float[Array, "S C"]) -> Float[np.ndarray, " n"]:
    """One over the size of each streamed lighting's indirect light, estimated with random probes ω as the root mean square
    of ωᵀ 𝒮 E (Hutchinson 1990); 0 where it causes none."""
    probes = np.random.default_rng(0).normal(size=(len(ds.transport.receivers), _PROBES))
    adjoint = importance(ds.transport, albedo, jnp.asarray(probes, jnp.float32))
    sizes = [np.linalg.norm(coefficients(adjoint, direct), axis=(0, 1)) for _, direct in streamed_blocks(ds)]
    size = np.concatenate(sizes) / _PROBES**0.5
    return np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0).astype(np.float32)


@jax.jit
def _error(factors: _Factors, examples: Examples, damping: Array) -> Array:
    """Squared error of the map of full rank on the training lightings."""
    channels = factors.response.shape[1]
    seen = jnp.matmul(factors.after(damping), examples.x, precision="highest")

    def missed(c: int) -> Array:
        light = jnp.matmul(jnp.asarray(factors.response[:, c], jnp.float64), seen[:, c::channels], precision="highest")
        return jnp.sum((light - examples.y[:, c::channels]) ** 2)

    return sum((missed(c) for c in range(channels)), jnp.zeros(()))


def _reduced(factors: _Factors, damping: Array, count: int) -> tuple[Array, Array, None, Array]:
    """Basis, one matrix per channel, no centre, and singular values."""
    light, after = jnp.asarray(factors.response, jnp.float64), factors.after(damping)
    told = jnp.matmul(light, jnp.matmul(after, factors.root, precision="highest"), precision="highest")
    flat = told.reshape(len(told), -1)
    u, values = leading_basis(flat, count, rounding_floor(flat, jnp.float32))
    matrix = jnp.einsum("tb,tcm->cbm", u, light, precision="highest")
    return u, jnp.matmul(matrix, after, precision="highest"), None, values
