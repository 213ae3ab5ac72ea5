"""Transfer textures for glossy surfaces: the full triple product for every pixel."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.glossy import TripleModel
from prt_bench.methods.base import Method
from prt_bench.methods.operator import fit_albedo
from prt_bench.methods.sh_texture import Window, all_light, windowed_transfer

GREATEST = 8
"""Greatest order of a triple product: some 13,000 entries."""


@dataclass(frozen=True)
class ShTriple(Method):
    """Diffuse light as `sh-texture`, and glossy reflection from the same K numbers per texel by the sparse triple product.

    Light, view and material may change at any time. `interreflection` stores transfer vectors with all diffuse bounces
    beside the direct ones; lobes see direct light alone (`interreflection.fix_light` has more, of one light).
    """

    name: ClassVar[str] = "sh-triple"
    summary: ClassVar[str] = "transfer textures: glossy PRT by sparse triple products in every pixel"
    citation: ClassVar[str] = "ng2004triple, in textures"
    learns: ClassVar[bool] = False

    order: int = 5
    window: Window = "none"
    interreflection: bool = True

    def __post_init__(self) -> None:
        self.require(1 <= self.order <= GREATEST, "order", f"from 1 to {GREATEST}")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> TripleModel:
        """Collect the transfer vectors from the traced rays; needs the transport alone."""
        return TripleModel(*self.vectors(ds))

    def vectors(self, ds: LightingDataset) -> tuple[Float[Array, "T W K"], Float[Array, "3"]]:
        """Basis and centre of a `TripleModel`."""
        direct, indirect = windowed_transfer(ds.transport, fit_albedo(ds), self.order, self.window)
        if self.interreflection:
            basis = jnp.concatenate([all_light(ds.transport, direct, indirect), direct], axis=1)
        elif ds.transport.walks is None:
            basis = direct
        else:  # bodies reflect direct light by their albedo alone
            basis = jnp.concatenate([all_light(ds.transport, direct, jnp.zeros_like(indirect)), direct], axis=1)
        return basis, jnp.asarray(ds.transport.scene.bounds.mean(axis=0))
