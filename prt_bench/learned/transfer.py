"""Neural transfer: a field of position and normal whose values are spherical-harmonic transfer vectors.

What a field adds to an open surface's vector is learned; that vector is known in closed form from the normal. Where targets
come from is no concern of this module: texels of a lightmap and samples of a signed distance serve alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import FitError
from prt_bench.harmonic import HarmonicModel, light_coefficients
from prt_bench.learned.fields import FEATURES, Encoding, Field, box_of, field_of, interpolated
from prt_bench.learned.losses import power_of_two, square
from prt_bench.learned.models import History
from prt_bench.learned.networks import Network, magnitudes
from prt_bench.learned.training import Schedule, train
from prt_bench.lights import emitters
from prt_bench.models import Model, Observed
from prt_bench.spherical import bands, cosine_lobe, evaluate, order_of

_BATCH = 1024
_HELD = 8  # of the points, one in as many says when weights are best


class TransferField(eqx.Module):
    """T(p, n) = A y(n) + φ(p, n): [W, K] transfer vectors in steradians at a point with a normal.

    A y(n), with A the bands of the clamped cosine, is the vector of a point that sees everything; the field φ learns what is
    hidden from it and what is reflected to it. The rows are the caller's: one, one for each channel, and one more for lobes.
    Differentiable as `Field` is.
    """

    field: Field
    rows: int = eqx.field(static=True)

    @property
    def order(self) -> int:
        """Number of bands."""
        return order_of(len(self.field.head) // self.rows)

    @eqx.filter_jit
    def __call__(self, position: Float[Array, "P 3"], normal: Float[Array, "P 3"]) -> Float[Array, "P W K"]:
        """Transfer vectors at points with unit normals."""
        learned = self.field(position, normal).reshape(len(position), self.rows, -1)
        return open_vectors(normal, self.order)[:, None] + learned

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """head [W, K, h], box, the network and the grids."""
        head = self.field.head.reshape(self.rows, -1, self.field.head.shape[1])
        plain = {"head": head, "box": self.field.box}
        plain |= {f"grid{at}": grid for at, grid in enumerate(self.field.grids)}
        return {**{name: np.asarray(array) for name, array in plain.items()}, **self.field.network.arrays()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> Self:
        """The inverse of `arrays`; other names are left alone."""
        network, head = Network.from_arrays(arrays), arrays["head"]
        levels = sum(name.startswith("grid") for name in arrays)
        grids = tuple(arrays[f"grid{at}"] for at in range(levels))
        octaves = (network.sizes[0] - 6 - FEATURES * levels) // 6
        return cls(Field(network, head.reshape(-1, head.shape[2]), arrays["box"], grids, octaves), head.shape[0])

    @property
    def bytes(self) -> int:
        """Of everything that it ships, as it is stored."""
        return sum(array.nbytes for array in self.arrays().values())


def open_vectors(normal: Float[Array, "P 3"], order: int) -> Float[Array, "P K"]:
    """∫ y_k max(n·ω, 0) dω of points that see the whole hemisphere about their normal."""
    lobe = jnp.asarray(cosine_lobe(order), normal.dtype)[bands(order)]
    return lobe * evaluate(normal, order)


class _Points(NamedTuple):
    """Examples: where points are, and what the field must add there."""

    position: Float[Array, "P 3"]
    normal: Float[Array, "P 3"]
    target: Float[Array, "P B"]


@dataclass(frozen=True)
class FieldShape:
    """Size of a network, what it sees of a position, and its training: about `steps` batches at a `rate`, for any number of
    points."""

    width: int = 64
    depth: int = 2
    encoding: Encoding = "frequency"
    steps: int = 5000
    rate: float = 1e-2

    def schedule(self, points: int) -> Schedule:
        """Passes over `points` that come to that many batches."""
        return Schedule.lasting(self.steps, points, _BATCH, self.rate, patience=40)


def fit_transfer(
    position: Float[np.ndarray, "P 3"] | Float[Array, "P 3"],
    normal: Float[np.ndarray, "P 3"] | Float[Array, "P 3"],
    vectors: Float[np.ndarray, "P W K"] | Float[Array, "P W K"],
    shape: FieldShape,
    key: jax.Array | None = None,
    name: str = "neural-transfer",
    checkpoint: Path | None = None,
) -> tuple[TransferField, History]:
    """Train a field in float32 on the squared error in SH space, which is that of the light under white noise.

    Seven points of eight are trained on, the eighth chooses the weights. The head begins as the ridge regression on random
    features. Targets are divided by a power of two, so any unit does. Raises `FitError` for points that are not finite or
    fewer than 16. Not differentiable.
    """
    place = jnp.asarray(position, jnp.float32), jnp.asarray(normal, jnp.float32)
    count, rows, harmonics = vectors.shape
    if count < 2 * _HELD or not bool(jnp.all(jnp.isfinite(jnp.asarray(vectors)))):
        raise FitError(
            f"{name} needs at least {2 * _HELD} points with finite transfer vectors, not {count} of any kind"
        )
    missing = jnp.asarray(vectors, jnp.float32) - open_vectors(place[1], order_of(harmonics))[:, None]
    target = missing.reshape(count, -1)
    scale = power_of_two(jnp.sqrt(jnp.mean(target**2)))
    first, second, third = jax.random.split(jax.random.key(0) if key is None else key, 3)
    shuffled = jax.random.permutation(third, count)
    held, kept = (
        _Points(*(part[chosen] for part in (*place, target / scale)))
        for chosen in (shuffled[: count // _HELD], shuffled[count // _HELD :])
    )
    begun = Field.random(first, shape.encoding, box_of(place[0]), shape.width, shape.depth, target.shape[1])
    begun = begun.with_closed_head(*kept)
    trained = train(
        (begun.network, begun.head, begun.grids), begun.box, kept, held, _loss, _score,
        shape.schedule(len(kept.target)), second, name, checkpoint,
    )  # fmt: skip
    found = field_of(trained.weights, begun.box)
    found = eqx.tree_at(lambda field: field.head, found, found.head * scale)
    return TransferField(found, rows), trained.history


def _loss(weights: Any, box: Array, batch: _Points, key: jax.Array) -> Float[Array, ""]:
    return square(field_of(weights, box)(batch.position, batch.normal), batch.target)


def _score(weights: Any, box: Array, held: _Points) -> Float[Array, ""]:
    return square(field_of(weights, box)(held.position, held.normal), held.target)


def relative_error(found: Float[Array, "*s"], wanted: Float[Array, "*s"]) -> float:
    """Root mean square difference over the root mean square wanted: of vectors in SH space, Parseval's error of light."""
    return float(jnp.linalg.norm(jnp.asarray(found) - jnp.asarray(wanted)) / jnp.linalg.norm(jnp.asarray(wanted)))


class HarmonicFieldModel(Model):
    """y = T(p, n) · L: distant light as K coefficients, transfer vectors from a network. Linear in the light.

    `centre` [3] is where near lights are seen from; `position` and `normal` [T, 3] are the receivers', where predictions are
    compared; the runtime has its own.
    """

    kernels: ClassVar[dict[str, str]] = {
        "measure": "harmonics",
        "transfer": "identity",
        "reconstruct": "field",
        "direct": "included",
    }
    narrow: ClassVar[tuple[str, ...]] = ("head", "matrix", "grid")
    compared: ClassVar[tuple[str, ...]] = ("position", "normal")

    transfer_field: TransferField
    centre: Float[Array, "3"]
    position: Float[Array, "T 3"]
    normal: Float[Array, "T 3"]
    curves: History | None = None

    @property
    def basis(self) -> Float[Array, "T W K"]:
        """Transfer vectors at the receivers."""
        return self.transfer_field(self.position, self.normal)

    def measure(self, ds: Observed) -> Float[Array, "N K C"]:
        """Coefficients of each lighting's distant light, W/m²/sr."""
        batch = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), emitters(ds.lightings))
        centre, order = self.centre.astype(jnp.float64), self.transfer_field.order
        found = jax.vmap(lambda lights: light_coefficients(lights, centre, order))(batch)
        return found[:, :, : ds.measured.shape[2]]

    def transfer(self, x: Float[Array, "N K C"]) -> Float[Array, "N K C"]:
        """The coefficients as they are."""
        return x

    def reconstruct(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Transfer vector · coefficients; as `HarmonicModel`."""
        return HarmonicModel(self.basis, self.centre).reconstruct(u)

    def magnitudes(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Sums of the sizes of what a prediction adds up: rounding may grow to these times eps."""
        field = self.transfer_field.field
        place = jnp.abs((self.position - field.box[:3]) * field.box[3])
        angles = [2.0**octave * np.pi * place + 1.0 for octave in range(field.octaves) for _ in "sc"]
        grids = [interpolated(jnp.abs(grid), place) + jnp.max(jnp.abs(grid)) for grid in field.grids]
        inputs = jnp.concatenate([place, jnp.abs(self.normal), *angles, *grids], axis=1)
        phi = jnp.einsum("ph,bh->pb", magnitudes(field.network, inputs), jnp.abs(field.head))
        known = jnp.abs(open_vectors(self.normal, self.transfer_field.order))[:, None]
        basis = known + phi.reshape(len(phi), self.transfer_field.rows, -1)
        return HarmonicModel(basis, self.centre).reconstruct(jnp.abs(u))

    @property
    def history(self) -> History:
        """What the training told."""
        return self.curves or {}

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """Those of the field, centre, and the receivers' places for comparison with the reference."""
        plain = {"centre": self.centre, "position": self.position, "normal": self.normal}
        return {**self.transfer_field.arrays(), **{name: np.asarray(array) for name, array in plain.items()}}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> Self:
        """The inverse of `arrays`."""
        return cls(TransferField.from_arrays(arrays), arrays["centre"], arrays["position"], arrays["normal"])
