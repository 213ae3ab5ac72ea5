"""Classical precomputed radiance transfer as it was first stored: a transfer vector at every vertex."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.dataset import LightingDataset
from prt_bench.harmonic import VertexHarmonicModel
from prt_bench.methods.base import Method
from prt_bench.methods.operator import fit_albedo
from prt_bench.methods.sh_texture import HIGHEST, Window, all_light, windowed_transfer


@dataclass(frozen=True)
class ShVertex(Method):
    """y = T · L with T at the vertices, interpolated across triangles; settings as in `sh-texture`.

    Memory goes with the number of vertices, and so does what is seen: a shadow inside a triangle is lost. Bake with
    `vertices` for it.
    """

    name: ClassVar[str] = "sh-vertex"
    summary: ClassVar[str] = "classical PRT: spherical-harmonic transfer vectors at the vertices"
    citation: ClassVar[str] = "sloan2002prt"
    learns: ClassVar[bool] = False

    order: int = 5
    window: Window = "none"

    def __post_init__(self) -> None:
        self.require(1 <= self.order <= HIGHEST, "order", f"from 1 to {HIGHEST}")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> VertexHarmonicModel:
        """Collect the transfer vectors from the rays traced at the vertices."""
        at_vertices, corners = ds.transport.at_vertices()
        direct, indirect = windowed_transfer(at_vertices, fit_albedo(ds), self.order, self.window)
        receivers = ds.transport.receivers
        corner = jnp.asarray(corners[receivers.face])
        centre = jnp.asarray(ds.transport.scene.bounds.mean(axis=0))
        basis = all_light(at_vertices, direct, indirect)
        return VertexHarmonicModel(basis, centre, corner, jnp.asarray(receivers.barycentric))
