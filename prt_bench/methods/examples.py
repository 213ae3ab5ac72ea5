"""Training examples as matrices: one column per (lighting, channel) pair, over the norm of its measured light.

Every linear method starts here, so that intensity, colour and black lightings are dealt with in one place.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from prt_bench.errors import FitError
from prt_bench.linalg import rounding_floor, safe_norm
from prt_bench.models import Observed


class Examples(NamedTuple):
    """Columns of normalised light in float64: measured x [M, n], indirect y [T, n], n = N·C with the channel fastest.

    `lit` [n] marks the columns that count: where nothing was measured, both columns are zero. `floor` is the singular value
    of y up to which everything is rounding.
    """

    x: Float[Array, "M n"]
    y: Float[Array, "T n"]
    lit: Bool[Array, " n"]
    floor: Float[Array, ""]

    @jax.jit
    def means(self) -> tuple[Float[Array, "M 1"], Float[Array, "T 1"]]:
        """Means of x and y over the lit columns."""
        count = jnp.maximum(jnp.sum(self.lit), 1)
        return jnp.sum(self.x, axis=1, keepdims=True) / count, jnp.sum(self.y, axis=1, keepdims=True) / count

    def less(self, x: Float[Array, "M 1"], y: Float[Array, "T 1"]) -> "Examples":
        """The examples about a centre; unlit columns stay zero."""
        return self._replace(x=(self.x - x) * self.lit, y=(self.y - y) * self.lit)


@jax.jit
def normalised(measured: Float[Array, "N M C"], indirect: Float[Array, "N T C"]) -> Examples:
    """x / ‖x‖ and y / ‖x‖ column by column. Differentiable; a black lighting contributes nothing, to the gradient too."""
    x, y = _columns(measured), _columns(indirect)
    norm = safe_norm(x, axis=0)
    lit = norm > 0
    scale = jnp.where(lit, 1.0 / jnp.where(lit, norm, 1.0), 0.0)
    y = y * scale
    return Examples(x * scale, y, lit[0], jax.lax.stop_gradient(rounding_floor(y, indirect.dtype)))


def training_light(ds: Observed) -> tuple[Array, Array]:
    """`measured` and `indirect` of a training split. Raises `FitError` for NaN, and where no lighting lights anything."""
    for name, light in (("measured", ds.measured), ("indirect", ds.indirect)):
        if isinstance(light, Tracer):
            continue
        if not np.all(np.isfinite(light)):
            raise FitError(f"the training split's {name} light has values that are not finite; bake it again")
        if name == "measured" and not np.any(light):
            raise FitError(
                "no training lighting lights any measurement point; give the fit lightings that reach the scene"
            )
    return jnp.asarray(ds.measured), jnp.asarray(ds.indirect)


def _columns(light: Float[Array, "N P C"]) -> Float[Array, "P n"]:
    return jnp.moveaxis(light.astype(jnp.float64), 1, 0).reshape(light.shape[1], -1)
