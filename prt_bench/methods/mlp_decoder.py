"""A neural field in place of basis textures: the closed-form basis taught to a network of position and normal."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.learned.fields import Encoding, Field, FieldModel, box_of, field_of
from prt_bench.learned.light import any_order_mean, in_float32
from prt_bench.learned.losses import power_of_two, relative_square, square
from prt_bench.learned.start import Start, start_from
from prt_bench.learned.training import Schedule, train
from prt_bench.linalg import relative_damping, ridge
from prt_bench.methods.base import Method


class _Texels(NamedTuple):
    """Examples of a field: where texels are, and what they receive under lights that are worth their singular values."""

    position: Float[Array, "T 3"]
    normal: Float[Array, "T 3"]
    target: Float[Array, "T B"]


_BATCH = 1024  # texels


@dataclass(frozen=True)
class MlpDecoder(Method):
    """y = φ(p, n) · u: φ a network of `depth` layers, each `width` wide, of position p and normal n; u a latent code of x.

    φ learns the functions of `reduced-rank`, each weighted by how much of the streamed lightings' light it carries, from every
    texel; its last layer begins as their least squares on random features. The code is then the least-squares answer for
    the field as it came out, u = φ⁺ U W x. `encoding` says what the network sees of a position besides itself: sines and
    cosines, or features of a grid that are trained with it. `loss` "relative" weighs dark texels like bright ones (see
    `relative_square`). About `steps` batches are taken at `rate`, all of them, since a field's error rises before it falls;
    the weights that are best for the training split are kept. A file named by `checkpoint` keeps the state of a training that
    is interrupted. The dataset must be baked with `streamed` lightings.
    """

    name: ClassVar[str] = "mlp-decoder"
    summary: ClassVar[str] = "reduced-rank with a neural field of position and normal in place of basis textures"
    citation: ClassVar[str] = (
        "this project: a neural field (mildenhall2020nerf, mueller2022instant) of a closed-form basis"
    )
    differentiable: ClassVar[bool] = False

    basis: int = 16
    width: int = 64
    depth: int = 2
    encoding: Encoding = "frequency"
    loss: Literal["square", "relative"] = "square"
    steps: int = 3000
    rate: float = 1e-2
    checkpoint: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(1 <= self.width <= 128, "width", "from 1 to 128")
        self.require(1 <= self.depth <= 8, "depth", "from 1 to 8")
        self.require(self.steps >= 1, "steps", "at least 1")
        self.require(0 < self.rate < float("inf"), "rate", "a positive number")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> FieldModel:
        """Fit in closed form in float64, then train in float32; not differentiable in the light of `ds`."""
        return self.train_from(ds, start_from(ds, self.basis, self.name), key)

    def train_from(self, ds: LightingDataset, start: Start, key: jax.Array | None = None) -> FieldModel:
        """Train from what `start_from` gave for as many functions; of `ds`, only where the receivers are is looked at."""
        linear = start.linear
        u = in_float32(start.examples).targets
        streamed = len(u) - len(u) // 3  # the rest is light on the surface that no lighting need resemble
        weight = jnp.sqrt(jnp.mean(u[:streamed] ** 2, axis=(0, 2)))
        target = linear.basis * weight
        scale = power_of_two(jnp.sqrt(jnp.mean(target**2)))
        points, mesh = ds.transport.receivers, ds.transport.scene.mesh
        place = jnp.asarray(points.position, jnp.float32), jnp.asarray(mesh.normals[points.face], jnp.float32)
        texels = _Texels(*place, jnp.asarray(target / scale, jnp.float32))
        held = in_float32(start.held)
        coefficients = held.targets / (weight / scale)[:, None]
        coefficients = jnp.where((weight > 0)[:, None], coefficients, 0.0).astype(jnp.float32)
        first, second = jax.random.split(jax.random.key(0) if key is None else key)
        begun = Field.random(first, self.encoding, box_of(place[0]), self.width, self.depth, self.basis)
        begun = begun.with_closed_head(*texels)
        loss = {"square": _square_loss, "relative": _relative_loss}[self.loss]
        trained = train(
            (begun.network, begun.head, begun.grids), (begun.box, jnp.sqrt(jnp.mean(texels.target**2))), texels,
            (texels, coefficients), loss, _score, Schedule.lasting(self.steps, len(points), _BATCH, self.rate, patience=40),
            second, self.label, Path(self.checkpoint) if self.checkpoint else None,
        )  # fmt: skip
        found = field_of(trained.weights, begun.box)
        position, normal = (part.astype(jnp.float64) for part in place)
        codes = _codes(found(position, normal), linear.basis, linear.weights)
        return FieldModel(found, codes, position, normal, linear.singular_values, trained.history)


@jax.jit
def _codes(
    phi: Float[Array, "T B"], basis: Float[Array, "T B"], weights: Float[Array, "W B M1"]
) -> Float[Array, "W B M1"]:
    """φ⁺ U W: the codes whose light is nearest to that of the linear model."""
    answer = ridge(phi.T, basis.T, relative_damping(phi.T, 1e-9)).T
    return jnp.einsum("bk,wkm->wbm", answer, weights, precision="highest")


def _square_loss(weights: Any, fixed: tuple[Array, Array], batch: _Texels, key: jax.Array) -> Float[Array, ""]:
    """Mean squared error of a texel's weighted functions: that of its light."""
    return square(field_of(weights, fixed[0])(batch.position, batch.normal), batch.target)


def _relative_loss(weights: Any, fixed: tuple[Array, Array], batch: _Texels, key: jax.Array) -> Float[Array, ""]:
    """The same relative to the texel's own size."""
    return relative_square(field_of(weights, fixed[0])(batch.position, batch.normal), batch.target, fixed[1])


def _score(weights: Any, fixed: tuple[Array, Array], held: tuple[_Texels, Array]) -> Float[Array, ""]:
    """Squared error of the light of the lightings held out, relative to it, by the errors of the functions at all texels."""
    texels, coefficients = held
    missed = field_of(weights, fixed[0])(texels.position, texels.normal) - texels.target
    gram = jnp.matmul(missed.T, missed, precision="highest") / len(missed)
    errors = jnp.einsum("nbc,bk,nkc->n", coefficients, gram, coefficients, precision="highest")
    return any_order_mean(errors)
