"""Data-driven PRT: principal components of the indirect light, and a ridge regression onto them from measured direct light."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.gamma import curve, in_gamma_space, over, root_mean_square
from prt_bench.linalg import leading_basis
from prt_bench.methods.base import Method
from prt_bench.methods.blocks import Blocks, fit_by_blocks
from prt_bench.methods.examples import Norm, measured_light, normalised, training_light
from prt_bench.methods.linear import linear_model, regress, warn_of_one_colour, warn_of_rank
from prt_bench.models import CoupledModel, LinearModel, Model, Observed, interleaved

Transfer = Literal["shared", "per-channel", "coupled"]


@dataclass(frozen=True)
class SvdRidge(Method):
    """The closed-form baseline: u = M x by ridge, y = ‖x‖ μ + U u.

    `basis` counts the mean, so 16 is the mean and 15 singular vectors. `ridge` is relative: λ = ridge · ‖X‖²_F / M with X
    before its mean is taken from it.
    `mean` False leaves the mean out, which makes the model additive in the light as well as homogeneous. `transfer` says
    what colour channels are: "shared", examples of one basis and one matrix (the paper's mono-channel form, its choice);
    "per-channel", examples of one basis with a matrix each; "coupled", parts of one vector with one set of coefficients
    (its multi-channel form), which takes three times the basis and knows no colours of light but those it was fitted to.
    `gamma` other than 1 fits and predicts gamma-corrected light (the paper's 2.2; see `prt_bench/gamma.py`). `normalise`
    says what a lighting's light is divided by in the fit (see `normalised`); the paper's setting is "measured".

    `memory` is in bytes: indirect light that takes more in float64 is read from the dataset twice, in blocks of receivers,
    and never as a whole (`experiments/fit_speed.py` measures time and memory). Predictions are the same to rounding of float32.
    Light that is traced or comes in float64 is in memory already, and stays there.
    """

    name: ClassVar[str] = "svd-ridge"
    summary: ClassVar[str] = "principal components of the indirect light, ridge regression from measured direct light"
    citation: ClassVar[str] = "belcour2022datadriven, eq. 13 in the form that type-checks"

    basis: int = 16
    ridge: float = 1e-3
    mean: bool = True
    transfer: Transfer = "shared"
    gamma: float = 1.0
    normalise: Norm = "indirect"
    memory: int = 2**28

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(0 <= self.ridge < float("inf"), "ridge", "zero or a positive number")
        self.require(0 < self.gamma < float("inf"), "gamma", "a positive number")
        self.require(self.memory > 0, "memory", "a positive number of bytes")

    def fit(self, ds: Observed, key: jax.Array | None = None) -> Model:
        """Fit in closed form. Warns when the data do not determine that many basis functions."""
        blocks = Blocks.over(ds, self.memory)
        measured, indirect = training_light(ds) if blocks is None else (measured_light(ds), None)
        channels = measured.shape[2]
        coupled = self.transfer == "coupled" and channels > 1
        if coupled:
            warn_of_one_colour(self.label, measured)
            measured = interleaved(measured)
            indirect = indirect if indirect is None else interleaved(indirect)
            blocks = blocks and blocks.interleaved()
        if self.gamma != 1:
            size = root_mean_square(measured)
            measured, indirect, blocks = (
                self._curved(measured, size),
                indirect if indirect is None else self._curved(indirect, size),
                blocks and blocks.then(lambda light: np.asarray(self._curved(jnp.asarray(light), size))),
            )
        settings = self.ridge, self.basis, self.mean, self.transfer == "per-channel", self.normalise
        model = fit_by_blocks(measured, blocks, *settings) if blocks else fit_svd_ridge(measured, indirect, *settings)
        warn_of_rank(self.label, model)
        model = CoupledModel.of(model, channels) if coupled else model
        return model if self.gamma == 1 else in_gamma_space(model, self.gamma)

    def _curved(self, light: Float[Array, "N P C"], size: Float[Array, "N 1 C"]) -> Float[Array, "N P C"]:
        return curve(over(light, size), self.gamma)


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
    uncentred = examples.x
    centre = examples.means() if mean else None
    if centre:
        examples = examples.less(*centre)
    u, values = leading_basis(examples.y, basis - mean, examples.floor)
    channels = indirect.shape[2] if per_channel else 1
    coefficients = jnp.matmul(u.T, examples.y, precision="highest")
    matrix, offset = regress(examples.x, coefficients, examples.norm, ridge_factor, uncentred, channels)
    return linear_model(u, matrix, centre, values, offset)
