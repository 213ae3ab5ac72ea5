"""The closest training lighting: what a lookup table of baked lightmaps achieves."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.methods.base import Method
from prt_bench.methods.examples import normalised, training_light
from prt_bench.models import NearestModel, Observed

_SEEN = 0.1
"""Share of the median ‖x‖, relative to the light caused, from which on a lighting counts as seen."""


@dataclass(frozen=True)
class Nearest(Method):
    """The training lighting whose measured light has the smallest angle to the observed one, scaled by its norm.

    Training lightings count with the sum of their channels: a light's channels differ by a factor only where nothing else
    is lit, and a choice between equals would be left to rounding. Each observed channel chooses for itself.
    """

    name: ClassVar[str] = "nearest"
    summary: ClassVar[str] = "the closest training lighting by measured light, scaled by its norm"
    citation: ClassVar[str] = "nearest neighbour by angle"
    role: ClassVar[str] = "floor"

    def fit(self, ds: Observed, key: jax.Array | None = None) -> NearestModel:
        """Keep the training light over ‖x‖, but for lightings that all but miss the measurement points.

        Such a lighting has next to nothing to be recognised by, and its light over ‖x‖ is out of all proportion.
        """
        examples = normalised(*(jnp.sum(light, axis=2, keepdims=True) for light in training_light(ds)))
        norm = examples.norm
        seen = norm > _SEEN * jnp.nanmedian(jnp.where(norm > 0, norm, jnp.nan))
        scale = jnp.where(seen, 1.0 / jnp.where(seen, norm, 1.0), 0.0)
        return NearestModel(examples.y * scale, (examples.x * scale).T)
