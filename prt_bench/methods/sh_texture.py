"""Classical precomputed radiance transfer, a transfer vector in every texel."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset, Transport, display_albedo
from prt_bench.harmonic import HarmonicIndirectModel, HarmonicModel
from prt_bench.methods.base import Method
from prt_bench.methods.escaping import transfer_vectors
from prt_bench.methods.operator import fit_albedo
from prt_bench.spherical import bands, hann, lanczos, positive

Window = Literal["none", "hann", "lanczos", "positive"]
_WINDOWS = {"none": np.ones, "hann": hann, "lanczos": lanczos, "positive": positive}
HIGHEST = 16
"""Greatest order of a method: 256 coefficients per texel and channel."""


@dataclass(frozen=True)
class ShTexture(Method):
    """y = T · L with spherical-harmonic coefficients L of distant light, inter-reflections included.

    `order` is the number of bands, so that K = order² coefficients; `window` damps the higher ones against ringing. `light`
    "all" is the method of its paper: shadows come from the transfer vectors too, and the runtime draws no shadow maps.
    "indirect" leaves direct light to shadow maps, as the methods that transfer direct to indirect light do. Nothing is
    learned from the training lightings.
    """

    name: ClassVar[str] = "sh-texture"
    summary: ClassVar[str] = "classical PRT: spherical-harmonic transfer vectors in a texture"
    citation: ClassVar[str] = "sloan2002prt"
    learns: ClassVar[bool] = False

    order: int = 5
    window: Window = "none"
    light: Literal["all", "indirect"] = "all"

    def __post_init__(self) -> None:
        self.require(1 <= self.order <= HIGHEST, "order", f"from 1 to {HIGHEST}")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> HarmonicModel:
        """Collect the transfer vectors from the traced rays; needs the transport alone."""
        direct, indirect = windowed_transfer(ds.transport, fit_albedo(ds), self.order, self.window)
        centre = jnp.asarray(ds.transport.scene.bounds.mean(axis=0))
        if self.light == "indirect":
            return HarmonicIndirectModel(indirect, centre)
        return HarmonicModel(all_light(ds.transport, direct, indirect), centre)


def windowed_transfer(
    transport: Transport, albedo: Float[Array, "S C"], order: int, kind: Window
) -> tuple[Float[Array, "T 1 K"], Float[Array, "T C K"]]:
    """Direct and indirect transfer vectors with the window in them, so that it costs nothing at run time."""
    damping = jnp.asarray(_WINDOWS[kind](order))[bands(order)]
    direct, indirect = transfer_vectors(transport, albedo, order)
    return jnp.asarray(direct)[:, None] * damping, jnp.asarray(indirect) * damping


def all_light(
    transport: Transport, direct: Float[Array, "T 1 K"], indirect: Float[Array, "T C K"]
) -> Float[Array, "T C K"]:
    """Transfer of direct and indirect light together, as receivers show them."""
    if transport.walks is None:
        return direct + indirect
    return direct * display_albedo(transport)[:, : indirect.shape[1], None] + indirect
