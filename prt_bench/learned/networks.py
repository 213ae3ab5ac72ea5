"""Small dense networks that a shader can evaluate, and what makes one homogeneous in the light.

No training lives here, and no light: a network is a pytree of matrices and biases.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.gamma import over, root_mean_square


def squareplus(v: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """(v + √(v² + 1)) / 2: a rectifier without a kink, of additions, products and one root (Barron 2021).

    Its slope lies strictly between 0 and 1, so rounding errors never grow in it, and it is the same to rounding on a GPU.
    """
    return 0.5 * (v + jnp.sqrt(v * v + 1.0))


class Network(eqx.Module):
    """Dense layers: `matrices` [out, in] and `biases` [out], `squareplus` after each of them.

    Differentiable in inputs and weights everywhere. Works on the last axis.
    """

    matrices: tuple[Float[Array, "o i"], ...]
    biases: tuple[Float[Array, " o"], ...]

    @classmethod
    def random(cls, key: jax.Array, sizes: Sequence[int]) -> "Network":
        """Weights of variance 1 / inputs (LeCun et al. 1998) and no bias, in float32, for the widths in `sizes`."""
        keys = jax.random.split(key, max(len(sizes) - 1, 1))
        shapes = list(pairwise(sizes))
        matrices = (
            jax.random.normal(each, (out, into), jnp.float32) / into**0.5
            for each, (into, out) in zip(keys, shapes, strict=False)
        )
        return cls(tuple(matrices), tuple(jnp.zeros(out, jnp.float32) for _, out in shapes))

    @property
    def sizes(self) -> tuple[int, ...]:
        """Width of the input and of every layer."""
        return (self.matrices[0].shape[1], *(len(bias) for bias in self.biases))

    def __call__(self, v: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
        """The activations of the last layer."""
        for matrix, bias in zip(self.matrices, self.biases, strict=True):
            v = squareplus(jnp.einsum("...i,oi->...o", v, matrix, precision="highest") + bias)
        return v

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """Weights by name: "matrix0", "bias0" and so on."""
        parts = {"matrix": self.matrices, "bias": self.biases}
        return {f"{name}{at}": np.asarray(layer) for name, layers in parts.items() for at, layer in enumerate(layers)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Float[Array, "..."]]) -> "Network":
        """The inverse of `arrays`; other names are left alone."""
        depth = sum(name.startswith("matrix") for name in arrays)
        return cls(
            tuple(arrays[f"matrix{at}"] for at in range(depth)), tuple(arrays[f"bias{at}"] for at in range(depth))
        )


def magnitudes(network: Network, v: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
    """Sums of the sizes of what a network adds up, for a bound on its rounding: it grows by no more than these times eps."""
    v = jnp.abs(v)
    for matrix, bias in zip(network.matrices, network.biases, strict=True):
        v = jnp.einsum("...i,oi->...o", v, jnp.abs(matrix)) + jnp.abs(bias) + 1.0
    return v


def homogeneous(network: Network, head: Float[Array, "W B h"], x: Float[Array, "N M C"]) -> Float[Array, "N B C"]:
    """s · H n(x / s) for each channel, s the root mean square of x: of degree 1 in the light, whatever the network does.

    `head` holds one matrix for all channels (W = 1) or one each; light of one channel then serves all W of them. 0 and with
    a finite gradient where a channel is dark.
    """
    size = root_mean_square(x)
    hidden = network(jnp.swapaxes(over(x, size), 1, 2))
    if len(head) == 1:
        return size * jnp.einsum("bh,nch->nbc", head[0], hidden, precision="highest")
    if hidden.shape[1] == 1:  # one product for all channels
        return size * jnp.einsum("cbh,nh->nbc", head, hidden[:, 0], precision="highest")
    return size * jnp.einsum("cbh,nch->nbc", head, hidden, precision="highest")
