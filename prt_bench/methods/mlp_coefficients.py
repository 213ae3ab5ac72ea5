"""A small network for what the best linear map leaves: measured light to coefficients, trained on streamed lightings."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.learned.light import Light, any_order_mean, in_float32
from prt_bench.learned.losses import power_of_two
from prt_bench.learned.models import ResidualModel
from prt_bench.learned.networks import Network, homogeneous
from prt_bench.learned.start import Start, start_from
from prt_bench.learned.training import Schedule, train
from prt_bench.methods.base import Method
from prt_bench.models import LinearModel


@dataclass(frozen=True)
class MlpCoefficients(Method):
    """u = W [x; ‖x‖] + s · H n(x / s): `reduced-rank`, and a network of `depth` layers, each `width` wide, for its residual.

    H begins at 0, so training begins at the closed form and can only leave it for less error on the training split, none of
    which it is trained on. Examples are the streamed lightings and smooth light on the surface (`surface_light`), which keeps
    the network sound for light unlike any of the scenario's. `epochs` and `rate` are those of the `Schedule`. A file named by
    `checkpoint` keeps the state of a training that is interrupted. The dataset must be baked with `streamed` lightings.
    """

    name: ClassVar[str] = "mlp-coefficients"
    summary: ClassVar[str] = "reduced-rank, and a small network for what its linear map leaves"
    citation: ClassVar[str] = "this project: a residual network on izenman1975reducedrank, barron2021squareplus"
    differentiable: ClassVar[bool] = False

    basis: int = 16
    width: int = 128
    depth: int = 2
    epochs: int = 300
    rate: float = 2e-3
    checkpoint: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(1 <= self.width <= 512, "width", "from 1 to 512")
        self.require(1 <= self.depth <= 8, "depth", "from 1 to 8")
        self.require(self.epochs >= 1, "epochs", "at least 1")
        self.require(0 < self.rate < float("inf"), "rate", "a positive number")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> ResidualModel:
        """Fit in closed form in float64, then train in float32; not differentiable in the light of `ds`."""
        return self.train_from(start_from(ds, self.basis, self.name), key)

    def train_from(self, start: Start, key: jax.Array | None = None) -> ResidualModel:
        """Train from what `start_from` gave for as many functions."""
        linear = start.linear
        examples, held = (_left(linear, light) for light in (start.examples, start.held))
        scale = power_of_two(jnp.sqrt(jnp.mean(examples.targets**2)))
        examples, held = (in_float32(light._replace(targets=light.targets / scale)) for light in (examples, held))
        first, second = jax.random.split(jax.random.key(0) if key is None else key)
        network = Network.random(first, [examples.x.shape[1]] + [self.width] * self.depth)
        head = jnp.zeros((len(linear.weights), self.basis, self.width), jnp.float32)
        trained = train(
            (network, head), None, examples, held, _loss, _score, Schedule(self.epochs, rate=self.rate, patience=20), second,
            self.label, Path(self.checkpoint) if self.checkpoint else None,
        )  # fmt: skip
        network, head = trained.weights
        return ResidualModel(linear, network, head * scale, trained.history)


@jax.jit
def _left(linear: LinearModel, light: Light) -> Light:
    """The same examples with what the linear map leaves of their coefficients."""
    x = jnp.broadcast_to(light.x, (*light.x.shape[:2], light.targets.shape[2]))
    return light._replace(targets=light.targets - linear.transfer(x))


def _loss(weights: tuple[Network, Array], fixed: None, batch: Light, key: jax.Array) -> Float[Array, ""]:
    """Mean squared error of a coefficient, grey light through the network once for all channels."""
    found = homogeneous(*weights, batch.x)
    return jnp.mean((found - batch.targets) ** 2)


def _score(weights: tuple[Network, Array], fixed: Any, held: Light) -> Float[Array, ""]:
    """The same over the lightings held out."""
    return any_order_mean(jnp.mean((homogeneous(*weights, held.x) - held.targets) ** 2, axis=(1, 2)))
