"""A method of another package: indirect light as one lightmap, as bright as the average measured light."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.methods.linear import linear_model
from prt_bench.models import LinearModel, Observed


@dataclass(frozen=True)
class Ambient(Method):
    """y = b · mean(x), with the lightmap b that fits best; `floor` mixes in a constant one."""

    name: ClassVar[str] = "ambient"
    summary: ClassVar[str] = "one lightmap, as bright as the average measured light"
    citation: ClassVar[str] = "an example"

    floor: float = 0.0

    def __post_init__(self) -> None:
        self.require(0 <= self.floor <= 1, "floor", "from 0 to 1")

    def fit(self, ds: Observed, key: jax.Array | None = None) -> LinearModel:
        """Least squares over lightings and channels, in float64."""
        examples = normalised(*training_light(ds))
        brightness = jnp.mean(examples.x, axis=0)
        lightmap = (examples.y @ brightness) / jnp.sum(brightness**2)
        lightmap = (1 - self.floor) * lightmap + self.floor * jnp.mean(lightmap)
        points = examples.x.shape[0]
        return linear_model(lightmap[:, None], jnp.full((1, 1, points), 1.0 / points, jnp.float64))
