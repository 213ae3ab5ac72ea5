"""svd-ridge on thousands of lightings: the operator's adjoint turns direct light into coefficients without a bake."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.linalg import leading_basis, relative_damping, ridge, safe_norm
from prt_bench.methods.base import Method
from prt_bench.methods.examples import column_scale, normalised, training_light
from prt_bench.methods.linear import linear_model, warn_of_rank
from prt_bench.methods.operator import coefficients, fit_albedo, importance, streamed_blocks
from prt_bench.methods.operator_ridge import RIDGES, Auto
from prt_bench.methods.prior import Kind, mixed, prior_columns
from prt_bench.models import LinearModel


@dataclass(frozen=True)
class StreamedRidge(Method):
    """u = M x, with M fitted to streamed lightings: direct light alone was kept of them, and u = (𝒮ᵀU)ᵀ E is what it causes.

    The basis is that of `svd-ridge` without its mean; the map is linear. `prior` is the share of surface patterns in the
    covariance, as in `operator-ridge`: it keeps the fit sound for light unlike any of the scenario's. `ridge` is relative;
    "auto" takes the one with the least error on the training lightings, which are not among the streamed ones. The dataset
    must be baked with `streamed` lightings.
    """

    name: ClassVar[str] = "streamed-ridge"
    summary: ClassVar[str] = "svd-ridge on thousands of lightings streamed through the traced operator"
    citation: ClassVar[str] = (
        "this project: belcour2022datadriven's regression, its examples from the operator's adjoint"
    )

    basis: int = 16
    ridge: float | Auto = "auto"
    prior: float = 0.02
    patterns: Kind = "cells"

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(self.ridge == "auto" or 0 <= self.ridge < float("inf"), "ridge", "zero, positive or 'auto'")
        self.require(0 <= self.prior <= 1, "prior", "from 0 to 1")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> LinearModel:
        """Fit in closed form; needs the transport and the streamed lightings of `ds`."""
        examples = normalised(*training_light(ds))
        u, values = leading_basis(examples.y, self.basis, examples.floor)
        adjoint = importance(ds.transport, fit_albedo(ds), u)
        patterns = prior_columns(ds, self.patterns)
        answers = coefficients(adjoint, patterns.direct)
        x, targets = streamed_examples(ds, adjoint)
        ridges = jnp.asarray(RIDGES if self.ridge == "auto" else (self.ridge,))
        channels, rows = len(answers), []
        for c in range(channels):
            lightings = _sized(x, targets[c], len(u))
            columns = mixed(lightings, (jnp.asarray(patterns.measured), answers[c]), self.prior)
            trained = examples.x[:, c::channels], jnp.matmul(u.T, examples.y[:, c::channels], precision="highest")
            rows.append(_regressions(*columns, *trained, ridges))
        best = jnp.argmin(jax.lax.stop_gradient(sum(errors for _, errors in rows)))
        model = linear_model(u, jnp.stack([matrices[best] for matrices, _ in rows]), singular_values=values)
        warn_of_rank(self.label, model)
        return model


def streamed_examples(
    ds: LightingDataset, adjoint: Float[Array, "C S B"]
) -> tuple[Float[Array, "M n"], Float[Array, "C B n"]]:
    """Measured light of the streamed lightings and the coefficients of the indirect light they cause."""
    x = jnp.asarray(ds.streamed.measured.T, jnp.float64)
    return x, jnp.concatenate([coefficients(adjoint, direct) for _, direct in streamed_blocks(ds)], axis=2)


@jax.jit
def _sized(x: Float[Array, "M n"], targets: Float[Array, "B n"], receivers: int) -> tuple[Array, Array]:
    """Both over the size of the indirect light, as `normalised` does by "indirect"; coefficients hold nearly all of it."""
    scale, _ = column_scale(x, safe_norm(targets, axis=0), receivers, "indirect")
    return x * scale, targets * scale


@jax.jit
def _regressions(
    x: Float[Array, "M n"], targets: Float[Array, "B n"],
    held_x: Float[Array, "M k"], held_targets: Float[Array, "B k"], ridges: Float[Array, " R"],
) -> tuple[Float[Array, "R B M"], Float[Array, " R"]]:  # fmt: skip
    """The ridge regression for each of `ridges`, and its squared error on other examples."""
    matrices = jax.vmap(lambda factor: ridge(x, targets, relative_damping(x, factor)))(ridges)
    missed = jnp.einsum("rbm,mk->rbk", matrices, held_x, precision="highest") - held_targets
    return matrices, jnp.sum(missed**2, axis=(1, 2))
