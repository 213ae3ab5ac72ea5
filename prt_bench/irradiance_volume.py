"""An irradiance volume: what a surface would receive anywhere in a box, from SH coefficients on a grid of probes.

Nine coefficients a probe are the first three bands of irradiance as a function of the normal; the rest of it is small, since a
cosine leaves little of higher ones (Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance Environment
Maps"; Greger et al. 1998, "The Irradiance Volume"). Tracing is left to `data_gen/effects/probes.py`.
"""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from prt_bench.spherical.harmonics import evaluate, quadrature

ORDER = 3
"""Bands of irradiance that are kept."""
_DEGREE = 2 * ORDER
"""Products of what is kept with irradiance up to its fifth band are integrated exactly; its fourth is zero (odd bands are)."""


class ProbeVolume(eqx.Module):
    """Irradiance under N lightings in a box from `low` to `high` [3], in metres, with the probes at the centres of equal cells.

    `coefficients` [N, P, 9, C] are in W/m², probes in the order of `np.indices(shape)`. Those inside bodies or beyond
    walls, `buried` [P], are left out. Where the box is a grid of rooms, each with `room`³ probes, `open_to` [P] says which of
    the 27 rooms around that of a probe, itself among them, are open to it: bits in the order of `np.indices((3, 3, 3))`; a
    place then has light from probes of these rooms alone. Differentiable in coefficients, places (almost everywhere) and
    normals.
    """

    low: Float[Array, "3"]
    high: Float[Array, "3"]
    buried: Bool[Array, " P"]
    coefficients: Float[Array, "N P K C"]
    shape: tuple[int, int, int] = eqx.field(static=True)
    open_to: Int[Array, " P"] | None = None
    room: int = eqx.field(static=True, default=1)

    def irradiance(self, position: Float[Array, "Q 3"], normal: Float[Array, "Q 3"]) -> Float[Array, "N Q C"]:
        """What surfaces at `position` with unit `normal` receive, W/m².

        Interpolated trilinearly between the probes that are not buried, clamped at the rim, 0 where all around are buried. As
        three bands overshoot, it may fall a little below 0.
        """
        cells = jnp.asarray(self.shape)
        place = jnp.clip((position - self.low) / (self.high - self.low) * cells - 0.5, 0.0, cells - 1.0)
        first = jnp.minimum(jnp.floor(place).astype(int), jnp.maximum(cells - 2, 0))
        along = place - first
        here = jnp.round(place).astype(int)
        total, mixed = 0.0, 0.0
        for corner in itertools.product((0, 1), repeat=3):
            step = jnp.asarray(corner)
            index = jnp.minimum(first + step, cells - 1)
            probe = self._number(index)
            weight = jnp.prod(jnp.where(step == 1, along, 1.0 - along), axis=1) * ~self.buried[probe]
            if self.open_to is not None:
                around = (index // self.room - here // self.room + 1) @ jnp.array([9, 3, 1])
                weight = weight * (self.open_to[self._number(here)] >> around & 1)
            total = total + weight
            mixed = mixed + weight[:, None, None] * self.coefficients[:, probe]
        mixed = mixed / jnp.where(total > 0, total, 1.0)[:, None, None]
        return jnp.einsum("nqkc,qk->nqc", mixed, evaluate(normal, ORDER))

    def _number(self, index: Int[Array, "Q 3"]) -> Int[Array, " Q"]:
        return (index[:, 0] * self.shape[1] + index[:, 1]) * self.shape[2] + index[:, 2]


def normals() -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "9 J"]]:
    """Directions for which a probe measures irradiance, and the matrix from those J values to its coefficients."""
    directions, weights = quadrature(_DEGREE)
    return np.asarray(directions), np.asarray(evaluate(directions, ORDER)).T * weights


def places(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], shape: tuple[int, int, int]) -> np.ndarray:
    """Positions [P, 3] of the probes: the centres of equal cells of a box."""
    index = np.indices(shape).reshape(3, -1).T
    return low + (index + 0.5) / np.array(shape) * (high - low)
