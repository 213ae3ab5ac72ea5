"""Shapes by their signed distance: exact ones, surfaces of a periodic field, a fractal, and what was sampled on a grid.

How they are joined and moved is in `operations.py`.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from prt_bench.errors import SceneError
from prt_bench.implicit.expression import TINY, Distance, Place, Real, Writer, length, length_code, like, number

_EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])


class _Exact(Distance):
    """A true distance: |∇d| = 1 almost everywhere."""

    @property
    def slope(self) -> float:
        """1."""
        return 1.0


class Sphere(_Exact):
    """|p| − r, about the origin."""

    radius: Real

    def __check_init__(self) -> None:
        _positive("a sphere's radius", self.radius)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """|p| − r."""
        return length(place) - like(self.radius, place)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        return write.name(f"plus({length_code(write, *place)}, {number(-float(self.radius))})")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """The cube around it."""
        return _symmetric([float(self.radius)] * 3)


class Box(_Exact):
    """A box about the origin, `half` [3] its half sides, with edges rounded by `rounding` metres inside those sides."""

    half: Float[Array, "3"] | tuple[float, float, float]
    rounding: Real = 0.0

    def __check_init__(self) -> None:
        _positive("a box's half sides", *np.asarray(self.half).ravel() - float(self.rounding))

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """|max(q, 0)| + min(max(q), 0) − r with q = |p| − half + r."""
        rounding = like(self.rounding, place)
        q = jnp.abs(place) - (like(self.half, place) - rounding)
        return length(jnp.maximum(q, 0.0)) + jnp.minimum(jnp.max(q, axis=-1), 0.0) - rounding

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        rounding = float(self.rounding)
        q = [
            write.name(f"plus(size({name}), {number(rounding - float(half))})")
            for name, half in zip(place, self.half, strict=True)
        ]
        beyond = [write.name(f"most({each}, constant({each}, 0.0))") for each in q]
        outside = length_code(write, *beyond)
        deepest = write.name(f"most(most({q[0]}, {q[1]}), {q[2]})")
        return write.name(f"plus({outside} + least({deepest}, constant({deepest}, 0.0)), {number(-rounding)})")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Itself."""
        return _symmetric(np.asarray(self.half, float))


class Torus(_Exact):
    """A ring about the y axis: `major` to the middle of the tube, `minor` the tube's radius."""

    major: Real
    minor: Real

    def __check_init__(self) -> None:
        _positive("a torus's radii", self.major, self.minor)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """|(|(x, z)| − R, y)| − r."""
        out = length(place[..., ::2]) - like(self.major, place)
        return length(jnp.stack([out, place[..., 1]], axis=-1)) - like(self.minor, place)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        x, y, z = place
        out = write.name(f"plus({length_code(write, x, z)}, {number(-float(self.major))})")
        return write.name(f"plus({length_code(write, out, y)}, {number(-float(self.minor))})")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Its box."""
        across = float(self.major) + float(self.minor)
        return _symmetric([across, float(self.minor), across])


class Cylinder(_Exact):
    """A capped cylinder about the y axis, from −`half` to `half`."""

    radius: Real
    half: Real

    def __check_init__(self) -> None:
        _positive("a cylinder's radius and half height", self.radius, self.half)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """As a box, in (|(x, z)|, |y|)."""
        across = length(place[..., ::2]) - like(self.radius, place)
        along = jnp.abs(place[..., 1]) - like(self.half, place)
        q = jnp.stack([across, along], axis=-1)
        return length(jnp.maximum(q, 0.0)) + jnp.minimum(jnp.max(q, axis=-1), 0.0)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        x, y, z = place
        across = write.name(f"plus({length_code(write, x, z)}, {number(-float(self.radius))})")
        along = write.name(f"plus(size({y}), {number(-float(self.half))})")
        beyond = [write.name(f"most({each}, constant({each}, 0.0))") for each in (across, along)]
        outside = length_code(write, *beyond)
        deepest = write.name(f"most({across}, {along})")
        return write.name(f"{outside} + least({deepest}, constant({deepest}, 0.0))")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Its box."""
        return _symmetric([float(self.radius), float(self.half), float(self.radius)])


class Plane(_Exact):
    """The half space below n · p = `offset`; it has no bounds, so a scene must intersect it with something or give its own."""

    normal: Float[Array, "3"] | tuple[float, float, float]
    offset: Real = 0.0

    def __check_init__(self) -> None:
        if not abs(float(np.linalg.norm(np.asarray(self.normal, float))) - 1.0) < 1e-6:
            raise SceneError(f"a plane has the normal {self.normal}, which is not of length 1; divide it by its length")

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """n · p − offset."""
        return jnp.sum(place * like(self.normal, place), axis=-1) - like(self.offset, place)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        terms = [f"{number(float(n))} * {name}" for n, name in zip(self.normal, place, strict=True)]
        return write.name(f"plus({' + '.join(terms)}, {number(-float(self.offset))})")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Infinite."""
        return _EVERYWHERE


class Gyroid(Distance):
    """A wall along the gyroid sin x cos y + sin y cos z + sin z cos x = 0 of a `period` in metres; without bounds.

    d = (|g| − t) / (√3 k), k = 2π / period, t = `thickness` in units of g. Every partial derivative of g is at most k, as
    |cos a cos b − sin c sin a| ≤ √(cos²a + sin²a), so |∇d| ≤ 1. The wall is about 2 t / (1.4 k) thick.
    """

    period: Real
    thickness: Real = 0.3

    def __check_init__(self) -> None:
        _positive("a gyroid's period and thickness", self.period, self.thickness)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """(|g| − t) / (√3 k)."""
        scale = 2.0 * np.pi / like(self.period, place)
        s, c = jnp.sin(scale * place), jnp.cos(scale * place)
        g = s[..., 0] * c[..., 1] + s[..., 1] * c[..., 2] + s[..., 2] * c[..., 0]
        return (jnp.abs(g) - like(self.thickness, place)) / (3.0**0.5 * scale)

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL."""
        scale = 2.0 * np.pi / float(self.period)
        turned = [write.name(f"{number(scale)} * {name}") for name in place]
        s, c = ([write.name(f"{each}({name})") for name in turned] for each in ("sine", "cosine"))
        terms = [f"times({s[i]}, {c[(i + 1) % 3]})" for i in range(3)]
        g = write.name(" + ".join(terms))
        thin = write.name(f"plus(size({g}), {number(-float(self.thickness))})")
        return write.name(f"{number(1.0 / (3.0**0.5 * scale))} * {thin}")

    @property
    def slope(self) -> float:
        """1."""
        return 1.0

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Infinite."""
        return _EVERYWHERE


class Mandelbulb(Distance):
    """The mandelbulb of power 8 by `iterations` of p ← p⁸ + c, whose polar axis is z; it lies within 1.2 of the origin.

    d = ½ |p| log|p| / |p'|, the estimate of Hart et al. 1989 for Julia sets; no bound of its slope is known, so rays step
    with a share that tests against differences hold. Few iterations give a smooth body, whose distance float32 resolves.
    Powers are three squarings of z + iρ and of (x + iy) / ρ, so no angle is taken and nothing is singular but the axis.
    """

    iterations: Literal[2, 3, 4, 5, 6] = eqx.field(static=True, default=4)

    def __call__(self, place: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """½ r log(r) / r'."""
        x, y, z = place[..., 0], place[..., 1], place[..., 2]
        growth = jnp.ones_like(x)
        squared = _square_of(x, y, z)
        for _ in range(self.iterations):
            inside = squared < 4.0
            rho = jnp.sqrt(jnp.maximum(x * x + y * y, TINY))
            height, radius = _eighth(z, rho)
            east, north = _eighth(x / rho, y / rho)
            grown = 8.0 * jnp.sqrt(squared) * squared**3 * growth + 1.0
            moved = (radius * east + place[..., 0], radius * north + place[..., 1], height + place[..., 2])
            growth = jnp.where(inside, grown, growth)
            x, y, z = (jnp.where(inside, new, old) for new, old in zip(moved, (x, y, z), strict=True))
            squared = _square_of(x, y, z)
        return 0.25 * jnp.log(squared) * jnp.sqrt(squared) / growth

    def code(self, write: Writer, place: Place) -> str:
        """The same in GLSL, every iteration written out."""
        x, y, z = place
        growth = write.name(f"constant({x}, 1.0)")
        squared = write.name(_square_code(x, y, z))
        for _ in range(self.iterations):
            rho = write.name(f"root(times({x}, {x}) + times({y}, {y}))")
            height, radius = _eighth_code(write, z, rho)
            east, north = _eighth_code(write, f"over({x}, {rho})", f"over({y}, {rho})")
            cube = write.name(f"times({squared}, times({squared}, {squared}))")
            grown = f"plus(8.0 * times(times(root({squared}), {cube}), {growth}), 1.0)"
            inside = write.name(f"value({squared}) < 4.0", "bool")
            moved = (f"times({radius}, {east}) + {place[0]}", f"times({radius}, {north}) + {place[1]}")
            growth = write.name(f"{inside} ? {grown} : {growth}")
            x, y, z = (
                write.name(f"{inside} ? {new} : {old}")
                for new, old in zip((*moved, f"{height} + {place[2]}"), (x, y, z), strict=True)
            )
            squared = write.name(_square_code(x, y, z))
        return write.name(f"0.25 * over(times(logarithm({squared}), root({squared})), {growth})")

    @property
    def slope(self) -> float:
        """An estimate: outside, the largest at 4096 places was 1.84 for two iterations."""
        return 2.0

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """The cube of side 2.5."""
        return _symmetric([1.25] * 3)


def _square_of(x: Array, y: Array, z: Array) -> Array:
    return jnp.maximum(x * x + y * y + z * z, TINY)


def _square_code(x: str, y: str, z: str) -> str:
    return f"at_least_tiny(times({x}, {x}) + times({y}, {y}) + times({z}, {z}))"


def _eighth(real: Array, imaginary: Array) -> tuple[Array, Array]:
    """Parts of (a + ib)⁸."""
    for _ in range(3):
        real, imaginary = real * real - imaginary * imaginary, 2.0 * real * imaginary
    return real, imaginary


def _eighth_code(write: Writer, real: str, imaginary: str) -> tuple[str, str]:
    a, b = write.name(real), write.name(imaginary)
    for _ in range(3):
        a, b = write.name(f"times({a}, {a}) - times({b}, {b})"), write.name(f"2.0 * times({a}, {b})")
    return a, b


def _symmetric(half: list[float] | np.ndarray) -> Float[np.ndarray, "2 3"]:
    half = np.asarray(half, float)
    return np.stack([-half, half])


def _positive(what: str, *values: Real) -> None:
    known = [float(value) for value in values if not isinstance(value, Tracer)]
    if not all(np.isfinite(value) and value > 0 for value in known):
        told = ", ".join(f"{value:g}" for value in known)
        raise SceneError(f"{what} must be positive and finite, not {told}; rounding counts against the sides of a box")
