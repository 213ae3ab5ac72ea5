"""Fitted models with networks in them. They are assets like any other; how their weights were found is no concern here."""

from collections.abc import Mapping
from typing import ClassVar, Self

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.gamma import over, root_mean_square
from prt_bench.learned.networks import Network, homogeneous, magnitudes
from prt_bench.models import LinearModel, Model

History = dict[str, Float[np.ndarray, " k"]]


class FinetunedModel(LinearModel):
    """A `LinearModel` that was trained: its asset is that of any other, and its curves say how it came about."""

    curves: History | None = None

    @property
    def history(self) -> History:
        """What the training told."""
        return self.curves or {}


class ResidualModel(Model):
    """u = W [x; ‖x‖] + s · H n(x / s), y = basis · u: a linear model, and a network n for what it leaves.

    s is the root mean square of x; `head` [W, B, h] is H, one matrix for all channels or one each. Homogeneous of degree 1 in
    the light; with H = 0 it is the linear model.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "residual", "reconstruct": "basis"}
    narrow: ClassVar[tuple[str, ...]] = ("basis", "head", "matrix")

    linear: LinearModel
    network: Network
    head: Float[Array, "W B h"]
    curves: History | None = None

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
        """The linear map, and the network's share. Raises `FitError` for another number of channels than was fitted."""
        return self.linear.transfer(x) + homogeneous(self.network, self.head, x)

    def reconstruct(self, u: Float[Array, "N B C"]) -> Float[Array, "N T C"]:
        """basis · u."""
        return self.linear.reconstruct(u)

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis, weights and head, and the network's matrices and biases."""
        return {**self.linear.arrays(), "head": np.asarray(self.head), **self.network.arrays()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> Self:
        """The inverse of `arrays`."""
        linear = LinearModel(arrays["basis"], arrays["weights"])
        return cls(linear, Network.from_arrays(arrays), arrays["head"])

    def magnitudes(self, x: Float[Array, "N M C"]) -> Float[Array, "N T C"]:
        """Sums of the sizes of what a prediction adds up: rounding may grow to these times eps."""
        sizes = LinearModel(jnp.abs(self.linear.basis), jnp.abs(self.linear.weights))
        size = root_mean_square(x)
        hidden = magnitudes(self.network, jnp.swapaxes(over(x, size), 1, 2))
        head = jnp.broadcast_to(jnp.abs(self.head), (x.shape[2], *self.head.shape[1:]))
        u = sizes.transfer(jnp.abs(x)) + size * jnp.einsum("cbh,nch->nbc", head, hidden)
        return sizes.reconstruct(u)

    @property
    def basis(self) -> Float[Array, "T B"]:
        """That of the linear model."""
        return self.linear.basis

    @property
    def singular_values(self) -> Float[Array, " n"] | None:
        """Those of the linear model."""
        return self.linear.singular_values

    @property
    def span(self) -> Float[Array, "T B"]:
        """The basis itself."""
        return self.linear.basis

    @property
    def spectrum(self) -> Float[Array, " n"] | None:
        """Singular values of the training light."""
        return self.linear.singular_values

    @property
    def history(self) -> History:
        """What the training told."""
        return self.curves or {}
