"""Learnt transfer: a small network of position and normal in place of the textures of classical PRT."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp

from prt_bench.dataset import LightingDataset
from prt_bench.learned.fields import Encoding
from prt_bench.learned.transfer import FieldShape, HarmonicFieldModel, fit_transfer
from prt_bench.methods.base import Method
from prt_bench.methods.operator import fit_albedo
from prt_bench.methods.sh_texture import Window, all_light, windowed_transfer

GREATEST = 6
"""Greatest order: three channels of 36 coefficients are as much as a fragment should evaluate."""


@dataclass(frozen=True)
class NeuralTransfer(Method):
    """y = T(p, n) · L: the transfer vectors of `sh-texture`, by a network of `depth` layers, each `width` wide.

    The network adds to the vector of an open surface, which the normal gives in closed form, what is hidden and what is
    reflected. Nothing but position and normal is asked of a surface, so the same network serves geometry without mesh and
    texture coordinates (`prt_bench.implicit`).
    `encoding` and `checkpoint` are as in `mlp-decoder`; training takes about `steps` batches at `rate`. Nothing is learned
    from the training lightings: the loss is that of the vectors.
    """

    name: ClassVar[str] = "neural-transfer"
    summary: ClassVar[str] = "classical PRT with transfer vectors from a small network of position and normal"
    citation: ClassVar[str] = "sloan2002prt, by a neural field (mildenhall2020nerf, mueller2022instant)"
    learns: ClassVar[bool] = False

    order: int = 5
    window: Window = "none"
    width: int = 64
    depth: int = 2
    encoding: Encoding = "frequency"
    steps: int = FieldShape().steps
    rate: float = FieldShape().rate
    checkpoint: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        self.require(1 <= self.order <= GREATEST, "order", f"from 1 to {GREATEST}")
        self.require(1 <= self.width <= 128, "width", "from 1 to 128")
        self.require(1 <= self.depth <= 8, "depth", "from 1 to 8")
        self.require(self.steps >= 1, "steps", "at least 1")
        self.require(0 < self.rate < float("inf"), "rate", "a positive number")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> HarmonicFieldModel:
        """Collect the transfer vectors from the traced rays, then train; needs the transport alone."""
        direct, indirect = windowed_transfer(ds.transport, fit_albedo(ds), self.order, self.window)
        points, mesh = ds.transport.receivers, ds.transport.scene.mesh
        normal = mesh.normals[points.face]
        shape = FieldShape(self.width, self.depth, self.encoding, self.steps, self.rate)
        checkpoint = Path(self.checkpoint) if self.checkpoint else None
        vectors = all_light(ds.transport, direct, indirect)
        found, curves = fit_transfer(points.position, normal, vectors, shape, key, self.label, checkpoint)
        centre = jnp.asarray(ds.transport.scene.bounds.mean(axis=0))
        place = jnp.asarray(points.position, jnp.float64), jnp.asarray(normal, jnp.float64)
        return HarmonicFieldModel(found, centre, *place, curves)
