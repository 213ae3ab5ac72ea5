"""Models of classical precomputed radiance transfer: distant light as spherical harmonics, a transfer vector per point.

Light is observed as K coefficients instead of at points in the scene, so nothing near or sharp survives. What is near is
taken to be as far away as it looks from the middle of the scene: the approximation that the method stands on.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.emitters import Emitters, strength
from prt_bench.errors import FitError
from prt_bench.lights import emitters
from prt_bench.models import Model, Observed
from prt_bench.spherical import evaluate, order_of


def light_coefficients(lights: Emitters, centre: Float[Array, "3"], order: int) -> Float[Array, "K C"]:
    """Coefficients of the radiance of Q distant lights [W/m²/sr]: Σ_q E_q y_k(ω_q), as seen from `centre`.

    E_q is the irradiance that emitter q causes there at normal incidence. Differentiable in the emitters.
    """
    offset = lights.position[:, :3] - centre * lights.position[:, 3:]
    length = jnp.sqrt(jnp.maximum(jnp.sum(offset**2, axis=1, keepdims=True), 1e-24))
    direction = offset / length

    def facing(emitter: Emitters, towards: Float[Array, "3"]) -> Float[Array, ""]:
        single = jax.tree.map(lambda leaf: leaf[None], emitter)
        return strength(single, centre[None], towards[None])[0, 0]

    irradiance = jax.vmap(facing)(lights, direction)[:, None] * lights.intensity
    return jnp.einsum("qk,qc->kc", evaluate(direction, order), irradiance, precision="highest")


class HarmonicModel(Model):
    """y = T · L for each channel: all the light that the K coefficients L of distant light cause, direct light included.

    basis [P, W, K] are the transfer vectors with W = 1 (grey surfaces) or C; `centre` [3] is where near lights are seen from.
    """

    kernels: ClassVar[dict[str, str]] = {
        "measure": "harmonics",
        "transfer": "identity",
        "reconstruct": "channels",
        "direct": "included",
    }

    basis: Float[Array, "P W K"]
    centre: Float[Array, "3"]

    @property
    def order(self) -> int:
        """Number of bands."""
        return order_of(self.basis.shape[2])

    def measure(self, ds: Observed) -> Float[Array, "N K C"]:
        """Coefficients of each lighting's distant light, W/m²/sr."""
        batch = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), emitters(ds.lightings))
        return jax.vmap(self.observe)(batch)[:, 0, :, : ds.measured.shape[2]]

    def observe(self, lights: Emitters) -> Float[Array, "1 K 3"]:
        """Coefficients of one lighting's emitters."""
        centre = self.centre.astype(lights.position.dtype)
        return light_coefficients(lights, centre, self.order)[None]

    def transfer(self, x: Float[Array, "N K C"]) -> Float[Array, "N K C"]:
        """The coefficients as they are."""
        return x

    def reconstruct(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Transfer vector · coefficients. Raises `FitError` for another number of channels than was fitted."""
        channels = self.basis.shape[1]
        if channels == 1:
            return jnp.einsum("pk,nkc->npc", self.basis[:, 0], u, precision="highest")
        if channels != u.shape[2]:
            raise FitError(
                f"the model has transfer vectors for each of {channels} channels, but the light has {u.shape[2]};"
                " fit it on a dataset with the same channels"
            )
        return jnp.einsum("pck,nkc->npc", self.basis, u, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis and centre."""
        return {"basis": np.asarray(self.basis), "centre": np.asarray(self.centre)}


class HarmonicIndirectModel(HarmonicModel):
    """The same for indirect light alone; the runtime adds direct light with its shadow maps."""

    kernels: ClassVar[dict[str, str]] = {"measure": "harmonics", "transfer": "identity", "reconstruct": "channels"}


class VertexHarmonicModel(HarmonicModel):
    """Transfer vectors at the V vertices of the mesh, interpolated across its triangles.

    `corner` [T, 3] and `barycentric` [T, 3] say where the receivers lie between them; the runtime interpolates by itself.
    """

    kernels: ClassVar[dict[str, str]] = {**HarmonicModel.kernels, "reconstruct": "vertices"}

    corner: Float[Array, "T 3"]
    barycentric: Float[Array, "T 3"]

    def reconstruct(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Light at the vertices, then between them."""
        at_vertices = super().reconstruct(u)
        corners = at_vertices[:, jnp.asarray(self.corner, jnp.int32)]
        return jnp.einsum("ti,ntic->ntc", self.barycentric, corners, precision="highest")

    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """basis and centre, and the receivers' places for comparison with the reference."""
        places = {"corner": np.asarray(self.corner), "barycentric": np.asarray(self.barycentric)}
        return {**super().arrays(), **places}
