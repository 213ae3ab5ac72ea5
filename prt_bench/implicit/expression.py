"""What a signed distance is: a function of a place that JAX differentiates and that writes itself as GLSL.

The abstract class and the writer of code live here; the shapes are in `shapes.py`, what joins and moves them in
`operations.py`, and what follows a ray through them in `tracing.py`.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

TINY = 1e-20
"""Least square that a root is taken of: lengths have gradient 0 at 0 instead of NaN. The same as in `dual.glsl`."""

Place = tuple[str, str, str]
"""Names of the three coordinates in a shader."""
Real = Float[Array, "..."] | Float[np.ndarray, "..."] | float


class Writer:
    """GLSL of one expression, line by line: assignments to variables of type `Number`, which is float or a dual number.

    `grids` collects the tables [G³] that expressions look up; what they hold lies in one buffer, one after another.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.grids: list[Float[np.ndarray, " G3"]] = []
        self._count = 0

    def name(self, expression: str, kind: str = "Number") -> str:
        """A new variable with that value."""
        self._count += 1
        self.lines.append(f"{kind} v{self._count} = {expression};")
        return f"v{self._count}"

    def table(self, values: Float[np.ndarray, " G3"]) -> int:
        """Where a table will begin in the buffer."""
        start = sum(grid.size for grid in self.grids)
        self.grids.append(np.ascontiguousarray(values, np.float32))
        return start


class Distance(eqx.Module):
    """Signed distance in metres: negative inside. Subclasses are final; their parameters are arrays that JAX may trace.

    Differentiable in the place and in every parameter, but for creases; on those it gives a slope of one side or between.
    """

    @abstractmethod
    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The distance at places, in their dtype. Never more than `slope` times the true one."""

    @abstractmethod
    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL: the name of the variable that holds it."""

    @property
    @abstractmethod
    def slope(self) -> float:
        """Bound of |∇d|: a step of |d| / slope along a ray never crosses the surface."""

    @property
    @abstractmethod
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Corners of a box that holds the surface; infinite for what has no end."""


def like(value: Real, place: Float[Array, "*n 3"]) -> Array:
    """A parameter in the precision of the place."""
    return jnp.asarray(value, place.dtype)


def length(v: Float[Array, "*n d"]) -> Float[Array, "*n"]:
    """√max(Σ v², `TINY`): gradient 0 at 0."""
    return jnp.sqrt(jnp.maximum(jnp.sum(v * v, axis=-1), TINY))


def number(value: Real) -> str:
    """A constant in GLSL, with all digits of float32; negative ones in brackets."""
    told = f"{np.float32(value):.9e}"
    return f"({told})" if told.startswith("-") else told


def length_code(write: Writer, *parts: str) -> str:
    """√max(Σ v², `TINY`)."""
    return write.name("root(" + " + ".join(f"times({part}, {part})" for part in parts) + ")")


@eqx.filter_jit
def distances(shape: Distance, place: Float[Array, "P 3"]) -> Float[Array, " P"]:
    """`shape(place)`, compiled once for all shapes of a structure."""
    return shape(place)


@eqx.filter_jit
def gradients(shape: Distance, place: Float[Array, "P 3"]) -> Float[Array, "P 3"]:
    """∇d by reverse differentiation; one product for all points, since each distance depends on its own place alone."""
    return jax.grad(lambda p: jnp.sum(shape(p)))(place)


def normals(shape: Distance, place: Float[np.ndarray, "P 3"], step: float) -> Float[np.ndarray, "P 3"]:
    """Unit ∇d. Where it vanishes, central differences over `step` metres; where those vanish too, +y."""
    found = in_few_sizes(gradients, shape, place)
    size = np.linalg.norm(found, axis=1, keepdims=True)
    flat = np.flatnonzero(size[:, 0] < _FLAT)
    if flat.size:
        for axis in range(3):
            offset = step * np.eye(3)[axis]
            ends = [in_few_sizes(distances, shape, place[flat] + sign * offset) for sign in (1.0, -1.0)]
            found[flat, axis] = (ends[0] - ends[1]) / (2.0 * step)
        size = np.linalg.norm(found, axis=1, keepdims=True)
    return np.where(size < _FLAT, np.array([0.0, 1.0, 0.0]), found / np.maximum(size, _FLAT)).astype(found.dtype)


_FLAT = 1e-4  # a gradient as short as this has no direction
_LEAST = 1024


def in_few_sizes(function: Callable[[Any, Any], Array], shape: Any, place: Float[np.ndarray, "P 3"]) -> np.ndarray:
    """`function(shape, place)` for any number of points, padded to a `padded_size`."""
    rows = np.resize(np.arange(len(place)), padded_size(len(place)))
    return np.array(function(shape, jnp.asarray(place[rows])))[: len(place)]


def padded_size(count: int) -> int:
    """The next power of four from 1024 on: few sizes, so that little is compiled."""
    size = _LEAST
    while size < count:
        size *= 4
    return size


def code_of(*shapes: Distance) -> tuple[str, Float[np.ndarray, " G"]]:
    """GLSL for the union of shapes, and the tables that it looks up: `float distance_at(vec3)`, `vec4 sloped_distance(vec3)`
    with ∇d and d, and `int part_at(vec3)`, the shape that is nearest.

    The first two are the same lines, once on numbers and once on dual numbers (see `dual.glsl`): the gradient is that of JAX.
    """
    write = Writer()
    found = [shape.code(write, ("x", "y", "z")) for shape in shapes]
    union = reduce(lambda a, b: f"least({a}, {b})", found)
    body = "".join(f"    {line}\n" for line in write.lines)
    place = "    float x = p.x, y = p.y, z = p.z;\n"
    plain = f"float distance_at(vec3 p) {{\n{place}{body}    return {union};\n}}\n".replace("Number", "float")
    dual = (
        "vec4 sloped_distance(vec3 p) {\n    vec4 x = vec4(1.0, 0.0, 0.0, p.x), y = vec4(0.0, 1.0, 0.0, p.y);\n"
        f"    vec4 z = vec4(0.0, 0.0, 1.0, p.z);\n{body}    return {union};\n}}\n"
    ).replace("Number", "vec4")
    choice = f"    int part = 0;\n    float nearest = {found[0]};\n" + "".join(
        f"    if ({each} < nearest) {{ part = {at}; nearest = {each}; }}\n" for at, each in enumerate(found) if at
    )
    part = f"int part_at(vec3 p) {{\n{place}{body}{choice}    return part;\n}}\n".replace("Number", "float")
    return plain + dual + part, np.concatenate([*write.grids, np.zeros(1, np.float32)])
