"""The mean picture: the mean lightmap of the training lightings, scaled by how much light was measured."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.methods.linear import linear_model
from prt_bench.models import LinearModel, Observed


@dataclass(frozen=True)
class Mean(Method):
    """y = ‖x‖ μ with the μ that fits the training light best: `svd-ridge` with a basis of one."""

    name: ClassVar[str] = "mean"
    summary: ClassVar[str] = "the mean lightmap, scaled by the norm of the measured light"
    citation: ClassVar[str] = "belcour2022datadriven, the mean alone"
    role: ClassVar[str] = "floor"

    def fit(self, ds: Observed, key: jax.Array | None = None) -> LinearModel:
        """Fit one lightmap that scales with ‖x‖ to the training light."""
        mu_x, mu_y = normalised(*training_light(ds)).means()
        return linear_model(jnp.zeros((mu_y.shape[0], 0)), jnp.zeros((1, 0, mu_x.shape[0])), (mu_x, mu_y))
