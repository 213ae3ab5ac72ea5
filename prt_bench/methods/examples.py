"""Training examples as matrices: one column per (lighting, channel) pair, each over a size of its own.

Every linear method starts here, so that intensity, colour and black lightings are dealt with in one place.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from prt_bench.errors import FitError
from prt_bench.linalg import rounding_floor, safe_norm
from prt_bench.models import Observed

Norm = Literal["indirect", "measured"]
VISIBLE = 0.1


class Examples(NamedTuple):
    """Columns of normalised light in float64: measured x [M, n], indirect y [T, n], n = N·C with the channel fastest.

    `norm` [n] is ‖x‖ of each column as normalised. Where nothing was measured the whole column is zero, so that it counts
    for nothing. `floor` is the singular value of y up to which everything is rounding.
    """

    x: Float[Array, "M n"]
    y: Float[Array, "T n"]
    norm: Float[Array, " n"]
    floor: Float[Array, ""]

    @jax.jit
    def means(self) -> tuple[Float[Array, "M 1"], Float[Array, "T 1"]]:
        """What ‖x‖ alone tells of x and y: the μ that fit μ ‖x‖ best. Plain means where all columns have norm 1."""
        return weighted_mean(self.x, self.norm), weighted_mean(self.y, self.norm)

    def less(self, x: Float[Array, "M 1"], y: Float[Array, "T 1"]) -> "Examples":
        """The examples about a centre that scales with ‖x‖."""
        return self._replace(x=self.x - x * self.norm, y=self.y - y * self.norm)


def weighted_mean(rows: Float[Array, "P n"], norm: Float[Array, " n"]) -> Float[Array, "P 1"]:
    """The μ whose multiples μ · norm fit the rows best; zero where all norms are."""
    energy = jnp.sum(norm**2)
    weight = norm / jnp.where(energy > 0, energy, 1.0)
    return jnp.matmul(rows, weight[:, None], precision="highest")


@partial(jax.jit, static_argnames="by")
def normalised(measured: Float[Array, "N M C"], indirect: Float[Array, "N T C"], by: Norm = "indirect") -> Examples:
    """Both lights of each column over the same size, so that intensity does not weigh and relative errors are fitted.

    By "measured", the size is ‖x‖ (Belcour et al. 2022). A lighting that all but misses the measurement points then has
    hundreds of times the weight of others, and its neighbourhood ruins the fit: this is seen with spots. By "indirect", the
    size is the root mean square of y; a tenth of that of x is added for lightings that hardly cause indirect light.
    Differentiable; a black lighting contributes nothing, to the gradient too.
    """
    x, y = columns(measured), columns(indirect)
    scale, norm = column_scale(x, safe_norm(y, axis=0), len(y), by)
    y = y * scale
    return Examples(x * scale, y, norm[0], jax.lax.stop_gradient(rounding_floor(y, indirect.dtype)))


def column_scale(
    x: Float[Array, "M n"], y_norm: Float[Array, "1 n"], receivers: int, by: Norm
) -> tuple[Float[Array, "1 n"], Float[Array, "1 n"]]:
    """What `normalised` multiplies each column by, from the norms of y; and ‖x‖ as normalised. Zero where x is dark."""
    norm = safe_norm(x, axis=0)
    lit = norm > 0
    size = norm
    if by == "indirect":
        root_mean_squares = (y_norm / receivers**0.5, VISIBLE * norm / len(x) ** 0.5)
        size = safe_norm(jnp.concatenate(root_mean_squares), axis=0)
    scale = jnp.where(lit, 1.0 / jnp.where(lit, size, 1.0), 0.0)
    return scale, norm * scale


def training_light(ds: Observed) -> tuple[Array, Array]:
    """`measured` and `indirect` of a training split. Raises `FitError` for NaN, and where no lighting lights anything."""
    measured = measured_light(ds)
    if not isinstance(ds.indirect, Tracer):
        require_finite("indirect", ds.indirect)
    return measured, jnp.asarray(ds.indirect)


def measured_light(ds: Observed) -> Array:
    """`measured` of a training split. Raises `FitError` as `training_light` does."""
    if not isinstance(ds.measured, Tracer):
        require_finite("measured", ds.measured)
        if not np.any(ds.measured):
            raise FitError(
                "no training lighting lights any measurement point; give the fit lightings that reach the scene"
            )
    return jnp.asarray(ds.measured)


def require_finite(name: str, light: Array | np.ndarray) -> None:
    """Raise `FitError` for NaN or infinite light of that name."""
    if not np.all(np.isfinite(light)):
        raise FitError(f"the training split's {name} light has values that are not finite; bake it again")


def columns(light: Float[Array, "N P C"]) -> Float[Array, "P n"]:
    """One column per (lighting, channel), the channel fastest, in float64."""
    return jnp.moveaxis(light.astype(jnp.float64), 1, 0).reshape(light.shape[1], -1)
