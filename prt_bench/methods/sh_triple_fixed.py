"""Transfer textures for glossy surfaces with the light fixed for a frame: one small matrix instead of the triple product."""

from dataclasses import dataclass
from typing import ClassVar

import jax

from prt_bench.dataset import LightingDataset
from prt_bench.glossy import FixedTripleModel
from prt_bench.methods.sh_triple import ShTriple


@dataclass(frozen=True)
class ShTripleFixed(ShTriple):
    """As `sh-triple`, with the sum over the light taken once per frame; settings and values are the same."""

    name: ClassVar[str] = "sh-triple-fixed"
    summary: ClassVar[str] = "transfer textures with the light fixed: a matrix of the light in every pixel"

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> FixedTripleModel:
        """Collect the transfer vectors from the traced rays; needs the transport alone."""
        return FixedTripleModel(*self.vectors(ds))
