"""Basis and linear map trained together by gradient steps, from the closed form: what it leaves to be gained, if anything."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.learned.light import (
    Light,
    any_order_mean,
    held_light,
    in_float32,
    refuse_derivatives,
    training_examples,
)
from prt_bench.learned.losses import power_of_two
from prt_bench.learned.models import FinetunedModel
from prt_bench.learned.training import Schedule, train
from prt_bench.methods.base import Method
from prt_bench.methods.linear import warn_of_rank
from prt_bench.methods.reduced_rank import ReducedRank
from prt_bench.models import LinearModel

_Weights = tuple[Float[Array, "K B"], Float[Array, "C B M1"]]


@dataclass(frozen=True)
class LinearFinetuned(Method):
    """y = P V W [x; ‖x‖], where P holds the first 2B functions of `reduced-rank`: V and W begin as its solution of rank B.

    Both are trained end to end on streamed lightings and smooth light on the surface, for the error of the light itself, and
    with a share of ‖x‖ that no linear map has; the weights with the least error on the training split are kept. The model
    costs what every linear one does. `epochs` and `rate` are those of the `Schedule`. A file named by `checkpoint` keeps the
    state of a training that is interrupted. The dataset must be baked with `streamed` lightings.
    """

    name: ClassVar[str] = "linear-finetuned"
    summary: ClassVar[str] = "reduced-rank, its basis and its map trained on by gradient steps"
    citation: ClassVar[str] = "this project: end-to-end training from izenman1975reducedrank"
    differentiable: ClassVar[bool] = False

    basis: int = 16
    epochs: int = 100
    rate: float = 3e-5
    checkpoint: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(self.epochs >= 1, "epochs", "at least 1")
        self.require(0 < self.rate < float("inf"), "rate", "a positive number")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> FinetunedModel:
        """Fit in closed form in float64, then train in float32; not differentiable in the light of `ds`."""
        refuse_derivatives(self.name, ds)
        wide = ReducedRank(min(2 * self.basis, len(ds.transport.receivers))).fit(ds)
        start = LinearModel(wide.basis[:, : self.basis], wide.weights[:, : self.basis], wide.singular_values)
        warn_of_rank(self.label, start)
        examples, held = (in_float32(take(ds, wide.basis)) for take in (training_examples, held_light))
        scale = power_of_two(jnp.sqrt(jnp.mean(examples.targets**2)))
        examples, held = (light._replace(targets=light.targets / scale) for light in (examples, held))
        weights = (
            jnp.eye(wide.basis.shape[1], self.basis, dtype=jnp.float32),
            jnp.asarray(start.weights / scale, jnp.float32),
        )
        trained = train(
            weights, None, examples, held, _loss, _score, Schedule(self.epochs, rate=self.rate, chunks=20, patience=3),
            jax.random.key(0) if key is None else key, self.label, Path(self.checkpoint) if self.checkpoint else None,
        )  # fmt: skip
        turned, matrix = trained.weights
        basis = jnp.matmul(wide.basis, turned, precision="highest")
        return FinetunedModel(basis, matrix * scale, wide.singular_values, trained.history)


def _predicted(weights: _Weights, x: Float[Array, "n M W"]) -> Float[Array, "n K C"]:
    """Coefficients on the wide basis; light of one channel serves all matrices."""
    turned, matrix = weights
    channels = max(len(matrix), x.shape[2])
    found = LinearModel(turned, matrix).transfer(jnp.broadcast_to(x, (*x.shape[:2], channels)))
    return jnp.einsum("kb,nbc->nkc", turned, found, precision="highest")


def _loss(weights: _Weights, fixed: None, batch: Light, key: jax.Array) -> Float[Array, ""]:
    """Mean squared error of a coefficient, which is that of the light."""
    return jnp.mean((_predicted(weights, batch.x) - batch.targets) ** 2)


def _score(weights: _Weights, fixed: Any, held: Light) -> Float[Array, ""]:
    """The same over the lightings held out."""
    return any_order_mean(jnp.mean((_predicted(weights, held.x) - held.targets) ** 2, axis=(1, 2)))
