"""Neural fields on a surface: a network from position and normal to the values of all basis functions there.

What a field is fitted to, and how, is no concern of this module.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.learned.models import History
from prt_bench.learned.networks import Network, magnitudes
from prt_bench.linalg import relative_damping, ridge
from prt_bench.models import LinearModel, Model

Encoding = Literal["none", "frequency", "grid"]
OCTAVES = 4
"""Sines and cosines of 1, 2, 4 and 8 half-turns across the scene, for each axis (Mildenhall et al. 2020)."""
LEVELS = (8, 16, 32)
"""Nodes along a side of each grid of features, two at every node (after Müller et al. 2022, dense instead of hashed)."""
FEATURES = 2
_HEAD_RIDGE = 1e-6


class Field(eqx.Module):
    """φ(p, n) = H f(e(p), n): `network` f, `head` [B, h], and e the encoding of the position in the scene's box.

    `box` [4] is the box's middle and one over half its longest side. With `grids`, tables [G³, 2] of features are read by
    trilinear interpolation, one per level; with `octaves` sines and cosines are. Differentiable but across the cells of a grid.
    """

    network: Network
    head: Float[Array, "B h"]
    box: Float[Array, "4"]
    grids: tuple[Float[Array, "G3 2"], ...] = ()
    octaves: int = eqx.field(static=True, default=0)

    @classmethod
    def random(
        cls, key: jax.Array, encoding: Encoding, box: Float[Array, "4"], width: int, depth: int, functions: int
    ) -> "Field":
        """Random features and a head of zeros, in float32."""
        octaves = OCTAVES if encoding == "frequency" else 0
        first, *rest = jax.random.split(key, 1 + len(LEVELS))
        grids = tuple(
            0.1 * jax.random.normal(each, (side**3, FEATURES), jnp.float32)
            for each, side in zip(rest, LEVELS, strict=True)
            if encoding == "grid"
        )
        inputs = 6 + 6 * octaves + FEATURES * len(grids)
        network = Network.random(first, [inputs] + [width] * depth)
        return cls(network, jnp.zeros((functions, width), jnp.float32), box, grids, octaves)

    def encoded(self, position: Float[Array, "P 3"], normal: Float[Array, "P 3"]) -> Float[Array, "P i"]:
        """Position in the box from −1 to 1, normal, and what the encoding makes of the position."""
        place = (position - self.box[:3]) * self.box[3]
        parts = [place, normal]
        for octave in range(self.octaves):
            angle = (2.0**octave * np.pi) * place
            parts += [jnp.sin(angle), jnp.cos(angle)]
        return jnp.concatenate([*parts, *(interpolated(grid, place) for grid in self.grids)], axis=1)

    def with_closed_head(
        self, position: Float[Array, "P 3"], normal: Float[Array, "P 3"], target: Float[Array, "P B"]
    ) -> "Field":
        """The same features under the head that is the ridge regression of targets at points with normals."""
        return _with_closed_head(self, position, normal, target)

    def features(self, position: Float[Array, "P 3"], normal: Float[Array, "P 3"]) -> Float[Array, "P h"]:
        """What the head weighs."""
        return self.network(self.encoded(position, normal))

    def __call__(self, position: Float[Array, "P 3"], normal: Float[Array, "P 3"]) -> Float[Array, "P B"]:
        """The basis functions at points with normals."""
        return jnp.einsum("ph,bh->pb", self.features(position, normal), self.head, precision="highest")


def box_of(position: Float[Array, "P 3"]) -> Float[Array, "4"]:
    """Middle of the points' box, and one over half of its longest side."""
    low, high = jnp.min(position, axis=0), jnp.max(position, axis=0)
    return jnp.append((low + high) / 2, 2.0 / jnp.maximum(jnp.max(high - low), np.finfo(np.float32).tiny))


def field_of(weights: Any, box: Float[Array, "4"]) -> Field:
    """The field of what is trained: network, head and grids."""
    network, head, grids = weights
    octaves = (network.sizes[0] - 6 - sum(grid.shape[1] for grid in grids)) // 6
    return Field(network, head, box, grids, octaves)


@jax.jit
def _with_closed_head(
    start: Field, position: Float[Array, "P 3"], normal: Float[Array, "P 3"], target: Float[Array, "P B"]
) -> Field:
    features = start.features(position, normal).astype(jnp.float64).T
    head = ridge(features, target.astype(jnp.float64).T, relative_damping(features, _HEAD_RIDGE))
    return Field(start.network, head.astype(jnp.float32), start.box, start.grids, start.octaves)


def interpolated(grid: Float[Array, "G3 2"], place: Float[Array, "P 3"]) -> Float[Array, "P 2"]:
    """Features at places in [−1, 1]³, trilinear between nodes; the node (i, j, k) is row i + G (j + G k)."""
    side = round(len(grid) ** (1 / 3))
    at = jnp.clip((place * 0.5 + 0.5) * (side - 1), 0.0, side - 1.0)
    low = jnp.minimum(jax.lax.stop_gradient(at).astype(jnp.int32), side - 2)
    share = at - low
    found = jnp.zeros((len(place), grid.shape[1]), jnp.result_type(grid, place))
    for corner in np.ndindex(2, 2, 2):
        i, j, k = ((low + np.array(corner)).T[axis] for axis in range(3))
        weight = jnp.prod(jnp.where(jnp.array(corner) == 1, share, 1.0 - share), axis=1)
        found += weight[:, None] * grid[i + side * (j + side * k)]
    return found


class FieldModel(Model):
    """u = W [x; ‖x‖], y = φ(p, n) · u: basis functions from a network in place of textures. Homogeneous of degree 1.

    `position` and `normal` [T, 3] are the receivers', where predictions are compared; the runtime has its own.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "linear", "reconstruct": "field"}
    narrow: ClassVar[tuple[str, ...]] = ("head", "matrix", "grid")
    compared: ClassVar[tuple[str, ...]] = ("position", "normal")

    field: Field
    weights: Float[Array, "W B M1"]
    position: Float[Array, "T 3"]
    normal: Float[Array, "T 3"]
    singular_values: Float[Array, " n"] | None = None
    curves: History | None = None

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
        """W [x; ‖x‖] per channel."""
        return LinearModel(self.head, self.weights).transfer(x)

    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """φ · u."""
        return jnp.einsum("tb,nbc->ntc", self.span, u, precision="highest")

    def magnitudes(self, x: Float[Array, "N M C"]) -> Float[Array, "N T C"]:
        """Sums of the sizes of what a prediction adds up: rounding may grow to these times eps.

        A sine's error is that of its angle, so it counts with the size of the angle.
        """
        field = self.field
        place = jnp.abs((self.position - field.box[:3]) * field.box[3])
        angles = [2.0**octave * np.pi * place + 1.0 for octave in range(field.octaves) for _ in "sc"]
        grids = [interpolated(jnp.abs(grid), place) + jnp.max(jnp.abs(grid)) for grid in field.grids]
        inputs = jnp.concatenate([place, jnp.abs(self.normal), *angles, *grids], axis=1)
        phi = jnp.einsum("ph,bh->pb", magnitudes(field.network, inputs), jnp.abs(field.head))
        sizes = LinearModel(phi, jnp.abs(self.weights))
        return sizes.reconstruct(sizes.transfer(jnp.abs(x)))

    @property
    def head(self) -> Float[Array, "B h"]:
        """That of the field."""
        return self.field.head

    @property
    def span(self) -> Float[Array, "T B"]:
        """The field at the receivers."""
        return self.field(self.position, self.normal)

    @property
    def basis(self) -> Float[Array, "T B"]:
        """The same, as other models call it."""
        return self.span

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the light that the closed form was fitted to."""
        return self.singular_values

    @property
    def history(self) -> History:
        """What the training told."""
        return self.curves or {}

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """weights, head and box, the network, the grids, and the receivers' places for comparison with the reference."""
        field = self.field
        plain = {"weights": self.weights, "head": field.head, "box": field.box}
        plain |= {f"grid{at}": grid for at, grid in enumerate(field.grids)}
        plain |= {"position": self.position, "normal": self.normal}
        return {**{name: np.asarray(array) for name, array in plain.items()}, **field.network.arrays()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> Self:
        """The inverse of `arrays`; the encoding shows in the grids and in the width of the first layer."""
        network = Network.from_arrays(arrays)
        levels = sum(name.startswith("grid") for name in arrays)
        grids = tuple(arrays[f"grid{at}"] for at in range(levels))
        octaves = (network.sizes[0] - 6 - FEATURES * levels) // 6
        field = Field(network, arrays["head"], arrays["box"], grids, octaves)
        return cls(field, arrays["weights"], arrays["position"], arrays["normal"])
