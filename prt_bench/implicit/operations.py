"""Distances of distances: what joins two shapes, sharply or smoothly, and what moves one."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SceneError
from prt_bench.implicit.expression import Distance, Place, Real, Writer, like, number


class Union(Distance):
    """min(a, b): what is in either. Exact outside where both are."""

    a: Distance
    b: Distance

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """min(a, b)."""
        return jnp.minimum(self.a(place), self.b(place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        return write.name(f"least({self.a.code(write, place)}, {self.b.code(write, place)})")

    @property
    def slope(self) -> float:
        """The steeper one's."""
        return max(self.a.slope, self.b.slope)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Of both."""
        return _around(self.a, self.b)


class Intersection(Distance):
    """max(a, b): what is in both. A lower bound of the distance outside."""

    a: Distance
    b: Distance

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """max(a, b)."""
        return jnp.maximum(self.a(place), self.b(place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        return write.name(f"most({self.a.code(write, place)}, {self.b.code(write, place)})")

    @property
    def slope(self) -> float:
        """The steeper one's."""
        return max(self.a.slope, self.b.slope)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """What the boxes share."""
        return _shared(self.a, self.b)


class Difference(Distance):
    """max(a, −b): a without b."""

    a: Distance
    b: Distance

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """max(a, −b)."""
        return jnp.maximum(self.a(place), -self.b(place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        return write.name(f"most({self.a.code(write, place)}, -{self.b.code(write, place)})")

    @property
    def slope(self) -> float:
        """The steeper one's."""
        return max(self.a.slope, self.b.slope)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Of a."""
        return self.a.bounds


class SmoothUnion(Distance):
    """min(a, b) − h² w / 4 with h = max(w − |a − b|, 0) / w: a fillet within `width` metres of where a and b are equal.

    The gradient is a mean of both with shares from 0 to 1, so the slope is no steeper than theirs. At most w / 4 of matter
    is added.
    """

    a: Distance
    b: Distance
    width: Real = 0.1

    def __check_init__(self) -> None:
        _blend(self.width)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The smooth minimum."""
        return _smooth_minimum(self.a(place), self.b(place), like(self.width, place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        return _smooth_code(write, self.a.code(write, place), self.b.code(write, place), float(self.width))

    @property
    def slope(self) -> float:
        """The steeper one's."""
        return max(self.a.slope, self.b.slope)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Of both, and the fillet."""
        return _around(self.a, self.b) + np.array([[-1.0], [1.0]]) * float(self.width) / 4.0


class SmoothIntersection(Distance):
    """−smooth minimum of (−a, −b): edges within `width` metres of where a and b are equal are rounded off."""

    a: Distance
    b: Distance
    width: Real = 0.1

    def __check_init__(self) -> None:
        _blend(self.width)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The smooth maximum."""
        return -_smooth_minimum(-self.a(place), -self.b(place), like(self.width, place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        a, b = (write.name(f"-{each.code(write, place)}") for each in (self.a, self.b))
        return write.name(f"-{_smooth_code(write, a, b, float(self.width))}")

    @property
    def slope(self) -> float:
        """The steeper one's."""
        return max(self.a.slope, self.b.slope)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """What the boxes share."""
        return _shared(self.a, self.b)


class Moved(Distance):
    """`shape`, `by` [3] metres from where it was."""

    shape: Distance
    by: Float[Array, "3"] | tuple[float, float, float]

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """d(p − by)."""
        return self.shape(place - like(self.by, place))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        x, y, z = (write.name(f"plus({name}, {number(-float(by))})") for name, by in zip(place, self.by, strict=True))
        return self.shape.code(write, (x, y, z))

    @property
    def slope(self) -> float:
        """As before."""
        return self.shape.slope

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Moved."""
        return self.shape.bounds + np.asarray(self.by, float)


class Turned(Distance):
    """`shape` turned by the matrix `rotation` [3, 3], which takes its directions to the world's."""

    shape: Distance
    rotation: Float[Array, "3 3"] | Float[np.ndarray, "3 3"]

    def __check_init__(self) -> None:
        matrix = np.asarray(self.rotation, float)
        if matrix.shape != (3, 3) or np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-5:
            raise SceneError("a rotation must be a 3 × 3 matrix whose rows are orthonormal; use Scaled for sizes")

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """d(Rᵀ p)."""
        return self.shape(jnp.einsum("...i,ij->...j", place, like(self.rotation, place), precision="highest"))

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        columns = np.asarray(self.rotation, float).T
        x, y, z = (
            write.name(" + ".join(f"{number(c)} * {name}" for c, name in zip(column, place, strict=True)))
            for column in columns
        )
        return self.shape.code(write, (x, y, z))

    @property
    def slope(self) -> float:
        """As before."""
        return self.shape.slope

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """The box around the turned box."""
        low, high = self.shape.bounds
        if not np.all(np.isfinite([low, high])):
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        turned = corners @ np.asarray(self.rotation, float).T
        return np.stack([turned.min(axis=0), turned.max(axis=0)])


class Scaled(Distance):
    """`shape`, `factor` times as large about the origin."""

    shape: Distance
    factor: Real

    def __check_init__(self) -> None:
        if not 0 < float(self.factor) < np.inf:
            raise SceneError(f"a shape is scaled by {float(self.factor):g}, but a size is positive and finite")

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """f d(p / f)."""
        factor = like(self.factor, place)
        return factor * self.shape(place / factor)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        factor = float(self.factor)
        x, y, z = (write.name(f"{number(1.0 / factor)} * {name}") for name in place)
        return write.name(f"{number(factor)} * {self.shape.code(write, (x, y, z))}")

    @property
    def slope(self) -> float:
        """As before."""
        return self.shape.slope

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Scaled."""
        return self.shape.bounds * float(self.factor)


def _smooth_minimum(a: Array, b: Array, width: Array) -> Array:
    h = jnp.maximum(width - jnp.abs(a - b), 0.0)
    return jnp.minimum(a, b) - h * h / (4.0 * width)


def _smooth_code(write: Writer, a: str, b: str, width: float) -> str:
    h = write.name(f"plus(-size({a} - {b}), {number(width)})")
    h = write.name(f"most({h}, constant({h}, 0.0))")
    return write.name(f"least({a}, {b}) - {number(0.25 / width)} * times({h}, {h})")


def _around(a: Distance, b: Distance) -> Float[np.ndarray, "2 3"]:
    return np.stack([np.minimum(a.bounds[0], b.bounds[0]), np.maximum(a.bounds[1], b.bounds[1])])


def _shared(a: Distance, b: Distance) -> Float[np.ndarray, "2 3"]:
    return np.stack([np.maximum(a.bounds[0], b.bounds[0]), np.minimum(a.bounds[1], b.bounds[1])])


def _blend(width: Real) -> None:
    if not 0 < float(width) < np.inf:
        raise SceneError(
            f"a blend is {float(width):g} m wide, but must be positive; use Union or Intersection for none"
        )
