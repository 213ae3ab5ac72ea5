"""Distances that were sampled on a grid, of a mesh above all (`data_gen` makes those)."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SceneError
from prt_bench.implicit.expression import Distance, Place, Writer, length, length_code, like, number


class GridDistance(Distance):
    """Quadratic B-spline with coefficients `values` [G³] at nodes `low` + `cell` · (i, j, k), row i + G (j + G k).

    So the gradient is continuous, and shading shows no cells. The spline smooths: it adds ∇²d `cell`² / 8 to a distance d, and
    terms of higher order: ∇²d is the sum of the two curvatures. Beyond the grid the distance is √(a² + b²),
    a to the grid and b at its nearest point.
    """

    values: Float[Array, " G3"] | Float[np.ndarray, " G3"]
    low: Float[Array, "3"] | Float[np.ndarray, "3"] | tuple[float, float, float]
    cell: float

    def __check_init__(self) -> None:
        values = np.asarray(self.values)
        side = self.side
        if side < 2 or side**3 != values.size or not np.all(np.isfinite(values)):
            raise SceneError(
                f"a grid of {values.size} distances is no cube of at least 2 nodes a side, or not finite; sample it again"
            )
        faces = np.ones((side,) * 3, bool)
        faces[1:-1, 1:-1, 1:-1] = False
        if values.min() >= 0 or values.reshape(faces.shape)[faces].min() <= 0:
            raise SceneError(
                "a grid of distances must be negative somewhere and positive all over its faces, or the surface is empty"
                " or leaves the grid; sample a larger box"
            )

    @property
    def side(self) -> int:
        """Nodes along a side."""
        return round(np.size(self.values) ** (1 / 3))

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The spline, and beyond the grid bounded from below. Nodes beyond its faces repeat those on them."""
        side, values = self.side, like(self.values, place)
        at = (place - like(self.low, place)) / like(self.cell, place)
        nearest = jnp.clip(at, 0.0, side - 1.0)
        middle = jax.lax.stop_gradient(jnp.floor(nearest + 0.5)).astype(jnp.int32)
        share = nearest - middle
        weights = (0.5 * (0.5 - share) ** 2, 0.75 - share**2, 0.5 * (0.5 + share) ** 2)
        found = jnp.zeros(place.shape[:-1], place.dtype)
        for step in product(range(3), repeat=3):
            i, j, k = (jnp.clip(middle[..., axis] + step[axis] - 1, 0, side - 1) for axis in range(3))
            weight = weights[step[0]][..., 0] * weights[step[1]][..., 1] * weights[step[2]][..., 2]
            found += weight * values[i + side * (j + side * k)]
        away = (at - nearest) * like(self.cell, place)
        beyond = jnp.max(jnp.abs(away), axis=-1) > 0
        return jnp.where(beyond, length(jnp.concatenate([away, found[..., None]], axis=-1)), found)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL, from a table in a buffer: samplers would round the shares."""
        side, start = self.side, write.table(np.asarray(self.values))
        at = [
            write.name(f"{number(1.0 / self.cell)} * plus({name}, {number(-float(low))})")
            for name, low in zip(place, np.asarray(self.low), strict=True)
        ]
        nearest = [write.name(f"clamped({each}, {side - 1}.0)") for each in at]
        found = write.name(f"looked_up({start}, {side}, {', '.join(nearest)})")
        away = [write.name(f"{number(self.cell)} * ({a} - {b})") for a, b in zip(at, nearest, strict=True)]
        farthest = f"max(max(abs(value({away[0]})), abs(value({away[1]}))), abs(value({away[2]})))"
        outside = length_code(write, *away, found)
        return write.name(f"{farthest} > 0.0 ? {outside} : {found}")

    @property
    def slope(self) -> float:
        """√Σ (largest difference along an axis / cell)²: the derivatives of the spline are means of these."""
        side = self.side
        table = np.asarray(self.values, float).reshape(side, side, side)
        steepest = [np.abs(np.diff(table, axis=axis)).max() / self.cell for axis in range(3)]
        return max(float(np.linalg.norm(steepest)), 1.0)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """The grid's box."""
        low = np.asarray(self.low, float)
        return np.stack([low, low + self.cell * (self.side - 1)])
