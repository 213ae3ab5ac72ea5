"""Data-driven PRT: principal components of the indirect light, and a ridge regression onto them from measured direct light."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.linalg import leading_basis
from prt_bench.methods.base import Method
from prt_bench.methods.examples import Norm, normalised, training_light
from prt_bench.methods.linear import linear_model, regress, warn_of_rank
from prt_bench.models import LinearModel, Observed

Transfer = Literal["shared", "per-channel"]


@dataclass(frozen=True)
class SvdRidge(Method):
    """The closed-form baseline: u = M x by ridge, y = ‖x‖ μ + U u.

    `basis` counts the mean, so 16 is the mean and 15 singular vectors. `ridge` is relative: λ = ridge · ‖X‖²_F / M.
    `mean` False leaves the mean out, which makes the model additive in the light as well as homogeneous. Colour channels
    are examples of one basis; `transfer` gives them one matrix or one each. `normalise` says what a lighting's light is
    divided by in the fit (see `normalised`); the paper's setting is "measured".
    """

    name: ClassVar[str] = "svd-ridge"
    summary: ClassVar[str] = "principal components of the indirect light, ridge regression from measured direct light"
    citation: ClassVar[str] = "belcour2022datadriven, eq. 13 in the form that type-checks"

    basis: int = 16
    ridge: float = 1e-3
    mean: bool = True
    transfer: Transfer = "shared"
    normalise: Norm = "indirect"

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(0 <= self.ridge < float("inf"), "ridge", "zero or a positive number")

    def fit(self, ds: Observed, key: jax.Array | None = None) -> LinearModel:
        """Fit in closed form. Warns when the data do not determine that many basis functions."""
        measured, indirect = training_light(ds)
        per_channel = self.transfer == "per-channel"
        model = fit_svd_ridge(measured, indirect, self.ridge, self.basis, self.mean, per_channel, self.normalise)
        warn_of_rank(self.label, model)
        return model


@partial(jax.jit, static_argnames=("basis", "mean", "per_channel", "normalise"))
def fit_svd_ridge(
    measured: Float[Array, "N M C"],
    indirect: Float[Array, "N T C"],
    ridge_factor: float | Float[Array, ""],
    basis: int,
    mean: bool = True,
    per_channel: bool = False,
    normalise: Norm = "indirect",
) -> LinearModel:
    """The fit as a pure function of arrays, differentiable in the light and (where positive) in `ridge_factor`."""
    examples = normalised(measured, indirect, normalise)
    centre = examples.means() if mean else None
    if centre:
        examples = examples.less(*centre)
    u, values = leading_basis(examples.y, basis - mean, examples.floor)
    channels = indirect.shape[2] if per_channel else 1
    coefficients = jnp.matmul(u.T, examples.y, precision="highest")
    return linear_model(u, regress(examples.x, coefficients, ridge_factor, channels), centre, values)
