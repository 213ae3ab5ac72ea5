"""Indirect light from a basis for each cluster of receivers: a receiver holds values of its own cluster's functions alone.

A basis for a whole scene has to be as large as all its rooms need together, and each receiver stores all of it. Here memory and
the time of a pixel grow with the functions of one cluster. Who fits such a model is in `methods/clustered_pca.py`.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.models import LinearModel, Model


class ClusteredModel(Model):
    """u = W [x; ‖x‖], y_t = Σ_k basis_tk u_{p(t), k}: B = P·K coefficients, K of each of P clusters.

    basis [T, K]; cluster [T] the whole number p of each receiver's cluster; weights [W, P·K, M + 1] as those of a
    `LinearModel`, one cluster's rows after another's. Homogeneous of degree 1 in the light, and differentiable in all but
    `cluster`. After "clustered PCA with local lights", eq. 10, whose transfer between clusters is multiplied into W here.
    """

    kernels: ClassVar[dict[str, str]] = {"measure": "direct", "transfer": "linear", "reconstruct": "clusters"}
    narrow: ClassVar[tuple[str, ...]] = ("basis", "cluster")

    basis: Float[Array, "T K"]
    cluster: Float[Array, " T"]
    weights: Float[Array, "W PK M1"]

    def transfer(self, x: Float[Array, "N M C"]) -> Float[Array, "N PK C"]:
        """W [x; ‖x‖] per channel. Raises `FitError` for another number of channels than was fitted."""
        return LinearModel(self.basis, self.weights).transfer(x)

    def reconstruct(self, u: Float[Array, "N PK C"]) -> Float[Array, "N T C"]:
        """Each receiver's functions times the coefficients of its cluster."""
        size = self.basis.shape[1]
        first = jnp.asarray(self.cluster, jnp.int32) * size
        return sum((self.basis[:, k, None] * u[:, first + k] for k in range(size)), start=jnp.zeros(()))

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis, cluster and weights."""
        return {name: np.asarray(getattr(self, name)) for name in ("basis", "cluster", "weights")}

    @property
    def span(self) -> Float[Array, "T PK"]:
        """Every function of every cluster, zero outside of it."""
        receivers, size = self.basis.shape
        columns = jnp.asarray(self.cluster, jnp.int32)[:, None] * size + jnp.arange(size)
        whole = jnp.zeros((receivers, self.weights.shape[1]), self.basis.dtype)
        return whole.at[jnp.arange(receivers)[:, None], columns].set(self.basis)
