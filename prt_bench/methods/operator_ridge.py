"""The traced operator as a prior: ridge regression that knows what light between the training lightings would do.

`svd-ridge` learns from lightings alone what direct light looks like between the measurement points. The bake already holds
the operator that answers it, so patterns of light around single measurement points join the training lightings at no cost
at run time.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.linalg import leading_basis, leave_one_out, relative_damping, ridge
from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.methods.linear import linear_model, warn_of_rank
from prt_bench.methods.operator import coefficients, fit_albedo, importance
from prt_bench.methods.prior import Kind, mixed, prior_columns, scale
from prt_bench.models import LinearModel

_Pair = tuple[Float[Array, "M n"], Float[Array, "B n"]]
Auto = Literal["auto"]
RIDGES = tuple(np.logspace(-4.0, -0.5, 8).tolist())
_SHARES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7)


@dataclass(frozen=True)
class OperatorRidge(Method):
    """u = Uᵀ 𝒮 Σ Aᵀ (A Σ Aᵀ + λ)⁻¹ x with the covariance Σ = (1 − prior) Σ_training + prior Σ_patterns of direct light.

    A measures direct light, 𝒮 sends it through all bounces. Σ_patterns is light on one pattern around each measurement
    point (`prior_columns`: "cells" or "surface"), independent between patterns; both covariances have the same trace at the
    measurement points. `prior` 0 is `svd-ridge` without its mean, 1 uses the lightings for the basis alone. `ridge` is
    relative to the trace. Either may be "auto": the pair with the least leave-one-out error over the training lightings
    is taken. The map is linear, so it is additive in the light as well as homogeneous.
    """

    name: ClassVar[str] = "operator-ridge"
    summary: ClassVar[str] = "svd-ridge with the traced operator as a prior on light never seen"
    citation: ClassVar[str] = "this project: best linear estimate under a mixture of lightings and surface patterns"

    basis: int = 16
    ridge: float | Auto = "auto"
    prior: float | Auto = "auto"
    patterns: Kind = "cells"

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(self.ridge == "auto" or 0 <= self.ridge < float("inf"), "ridge", "zero, positive or 'auto'")
        self.require(self.prior == "auto" or 0 <= self.prior <= 1, "prior", "from 0 to 1, or 'auto'")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> LinearModel:
        """Fit in closed form; needs the transport that `ds` was baked with, as well as its lightings."""
        examples = normalised(*training_light(ds))
        u, values = leading_basis(examples.y, self.basis, examples.floor)
        patterns = prior_columns(ds, self.patterns)
        answers = coefficients(importance(ds.transport, fit_albedo(ds), u), patterns.direct)
        channels = len(answers)
        targets = jnp.matmul(u.T, examples.y, precision="highest")
        lightings = [(examples.x[:, c::channels], targets[:, c::channels]) for c in range(channels)]
        prior = [(jnp.asarray(patterns.measured), answers[c]) for c in range(channels)]
        ridge_factor, share = self._chosen(lightings, prior)
        matrix = jnp.stack(
            [_regress(*mixed(*pairs, share), ridge_factor) for pairs in zip(lightings, prior, strict=True)]
        )
        model = linear_model(u, matrix, singular_values=values)
        warn_of_rank(self.label, model)
        return model

    def _chosen(self, lightings: list[_Pair], prior: list[_Pair]) -> tuple[float | Array, float | Array]:
        """Ridge and prior share: as set, or the pair with the least leave-one-out error."""
        ridges = RIDGES if self.ridge == "auto" else (self.ridge,)
        shares = _SHARES if self.prior == "auto" else (self.prior,)
        if len(ridges) * len(shares) == 1:
            return ridges[0], shares[0]
        rows = [
            sum(
                _left_out(pair, patterns, share, jnp.asarray(ridges))
                for pair, patterns in zip(lightings, prior, strict=True)
            )
            for share in shares
        ]
        best = jnp.argmin(jax.lax.stop_gradient(jnp.stack(rows)))
        return jnp.asarray(ridges)[best % len(ridges)], jnp.asarray(shares)[best // len(ridges)]


@jax.jit
def _regress(x: Float[Array, "M n"], targets: Float[Array, "B n"], ridge_factor: float | Array) -> Float[Array, "B M"]:
    return ridge(x, targets, relative_damping(x, ridge_factor))


@jax.jit
def _left_out(lightings: _Pair, prior: _Pair, share: float | Array, ridges: Float[Array, " R"]) -> Float[Array, " R"]:
    """Squared leave-one-out error over the lightings for each ridge; the patterns always stay in the fit."""
    x, targets = mixed(lightings, prior, share)
    count = lightings[0].shape[1]

    def error(ridge_factor: Array) -> Array:
        residual = leave_one_out(x, targets, relative_damping(x, ridge_factor))[:, :count]
        return jnp.sum(residual**2)

    return jax.vmap(error)(ridges) / scale(1.0 - share, lightings[0]) ** 2
