"""One ambient colour everywhere: the least that stands in for indirect light."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.methods.linear import linear_model
from prt_bench.models import LinearModel, Observed


@dataclass(frozen=True)
class Constant(Method):
    """y = a ‖x‖ at every receiver, with the a that fits the normalised training light best."""

    name: ClassVar[str] = "constant"
    summary: ClassVar[str] = "one ambient colour, scaled by the norm of the measured light"
    citation: ClassVar[str] = "the ambient term"
    role: ClassVar[str] = "floor"

    def fit(self, ds: Observed, key: jax.Array | None = None) -> LinearModel:
        """Average over receivers what ‖x‖ tells of them."""
        mu_x, mu_y = normalised(*training_light(ds)).means()
        return linear_model(
            jnp.zeros((mu_y.shape[0], 0)), jnp.zeros((1, 0, mu_x.shape[0])), (mu_x, jnp.full_like(mu_y, jnp.mean(mu_y)))
        )
