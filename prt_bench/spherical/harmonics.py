"""Real spherical harmonics as polynomials in x, y, z: values, indices, and a quadrature that integrates them exactly.

The convention of everything in this package: orthonormal over the unit sphere, z the polar axis, index l(l + 1) + m, and no
Condon–Shortley phase, so that y₁ = √(3/4π) (y, z, x) with positive signs. `order` is the number of bands, K = order².
"""

from collections.abc import Callable
from functools import cache, partial
from math import isqrt
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.errors import SpecError

Real = Float[Array, "..."] | Float[np.ndarray, "..."]
"""Floating numbers of JAX or NumPy."""


def count(order: int) -> int:
    """Number of coefficients K = order². Raises `SpecError` for an order below 1."""
    if order < 1:
        raise SpecError(f"a spherical-harmonic order is {order}, but must be at least 1")
    return order * order


def order_of(coefficients: int) -> int:
    """The order of a number of coefficients K. Raises `SpecError` where K is no positive square."""
    order = isqrt(max(coefficients, 0))
    if order < 1 or order * order != coefficients:
        raise SpecError(f"{coefficients} is no number of spherical-harmonic coefficients; use 1, 4, 9, 16, 25, …")
    return order


def bands(order: int) -> Int[np.ndarray, " K"]:
    """The band l of every index."""
    return np.repeat(np.arange(order), 2 * np.arange(order) + 1)


def azimuths(order: int) -> Int[np.ndarray, " K"]:
    """The azimuthal number m of every index: sines of |m|φ where negative, cosines else."""
    return np.arange(count(order)) - bands(order) * (bands(order) + 1)


@partial(jax.jit, static_argnames="order")
def evaluate(directions: Float[Array, "... 3"] | Float[np.ndarray, "... 3"], order: int) -> Float[Array, "... K"]:
    """All harmonics up to `order` at unit directions, in their dtype (integers: float64).

    Differentiable everywhere, poles included: sinᵐθ cos mφ and sinᵐθ sin mφ are polynomials in x and y, and what they are
    multiplied by is one in z, found by the normalised three-term recurrence in l (no factorials, no angles, no roots).
    Nothing is normalised: off the sphere these polynomials go on, with other values than at the direction divided by its
    length. So of a gradient only the part tangent to the sphere is a property of the harmonics.
    Rounding at order 30: 2e-13 in float64, 5e-6 in float32.
    """
    count(order)
    directions = jnp.asarray(directions)
    if not jnp.issubdtype(directions.dtype, jnp.floating):
        directions = directions.astype(jnp.float64)
    x, y, z = jnp.moveaxis(directions, -1, 0)
    in_height = _in_height(z, order)
    if order > _PLAIN:
        near = jnp.abs(z) > 1.0 - 0.5 / order
        in_height = jnp.where(near, _near_poles(z, order), in_height)
    band, m = bands(order), azimuths(order)
    return jnp.moveaxis(in_height[band, np.abs(m)] * _in_azimuth(x, y, order)[m + order - 1], 0, -1)


_PLAIN = 12
"""Orders above this take care of rounding near the poles."""
_UNROLLED = 6


def _in_azimuth(x: Array, y: Array, order: int) -> Float[Array, "azimuths ..."]:
    """sinᵐθ sin mφ for m from order − 1 down to 1, then sinᵐθ cos mφ for m from 0 up: powers of x + iy."""

    def step(power: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        cosine, sine = power
        return (x * cosine - y * sine, x * sine + y * cosine), power

    _, (cosines, sines) = _scan(step, (jnp.ones_like(x), jnp.zeros_like(x)), None, order)
    return jnp.concatenate([sines[:0:-1], cosines])


def _in_height(z: Array, order: int) -> Float[Array, "order order ..."]:
    """The polynomials q[l, m] in z of y_lm = q · sinᵐθ (cos mφ, sin mφ)."""

    def step(found: tuple[Array, Array], table: tuple[Array, ...]) -> tuple[tuple[Array, Array], Array]:
        last, before = found
        ahead, behind, first = table
        following = ahead * (z * last) - behind * before + first
        return (following, last), following

    zero = jnp.zeros((order, *z.shape), z.dtype)
    return _scan(step, (zero, zero), tuple(_against(table, z) for table in _recurrence(order)), order)[1]


def _near_poles(z: Array, order: int) -> Float[Array, "order order ..."]:
    """The same, by steps in multiples of 1 − |z|, which is exact near the poles: l² roundings of z are not added up.

    r = q(z) / q(1) has r_l − r_{l−1} = ((2l − 1)(z − 1) r_{l−1} + (l − m − 1)(r_{l−1} − r_{l−2})) / (l + m), after Reinsch.
    Away from the poles, where r is small, this would cancel.
    """
    side = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    gap = side * z - 1.0

    def step(found: tuple[Array, Array], table: tuple[Array, ...]) -> tuple[tuple[Array, Array], Array]:
        ratio, change = found
        at_pole, fall, keep, first, odd = table
        change = fall * (gap * ratio) + keep * change
        ratio = ratio + change + first
        return (ratio, change), at_pole * ratio * (1.0 + odd * (side - 1.0))

    zero = jnp.zeros((order, *z.shape), z.dtype)
    return _scan(step, (zero, zero), tuple(_against(table, z) for table in _steps(order)), order)[1]


def _scan(step: Callable[..., Any], start: Any, tables: Any, order: int) -> Any:
    """A loop over bands; unrolled where that is short, because what is unrolled is compiled for long."""
    return jax.lax.scan(step, start, tables, order, unroll=order if order <= _UNROLLED else 1)


def _against(table: np.ndarray, z: Array) -> np.ndarray:
    return table.astype(z.dtype).reshape(*table.shape, *[1] * z.ndim)


@cache
def _recurrence(order: int) -> tuple[np.ndarray, ...]:
    """q[l, m] = ahead[l, m] z q[l − 1, m] − behind[l, m] q[l − 2, m] + first[l, m], where `first` holds the q[m, m] alone."""
    band, m = np.indices((order, order), dtype=float)
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.where(m < band, np.sqrt((4 * band**2 - 1) / (band**2 - m**2)), 0.0)
        behind = np.sqrt((2 * band + 1) * ((band - 1) ** 2 - m**2) / ((2 * band - 3) * (band**2 - m**2)))
        behind = np.where(m < band - 1, behind, 0.0)
    return ahead, behind, np.diag(_sectoral(order))


def _sectoral(order: int) -> Float[np.ndarray, " order"]:
    """q[m, m]: √((2m + 1)!! / (2m)!! / 4π), times √2 where m > 0."""
    steps = np.arange(1, order)
    growth = np.cumprod(np.concatenate([[1.0], np.sqrt((2 * steps + 1) / (2 * steps))]))
    return growth * np.where(np.arange(order) > 0, np.sqrt(2.0), 1.0) / np.sqrt(4 * np.pi)


@cache
def _steps(order: int) -> tuple[np.ndarray, ...]:
    """q[l, m] at z = 1, the two factors of a step, where ratios start at one, and where l + m is odd."""
    band, m = np.indices((order, order), dtype=float)
    with np.errstate(invalid="ignore", divide="ignore"):
        growth = np.where(m < band, np.sqrt((2 * band + 1) / (2 * band - 1) * (band + m) / (band - m)), 1.0)
        fall = np.where(m < band, (2 * band - 1) / (band + m), 0.0)
        keep = np.where(m < band, (band - m - 1) / (band + m), 0.0)
    at_pole = np.tril(np.cumprod(growth, axis=0) * _sectoral(order))
    return at_pole, fall, keep, np.eye(order), (band + m) % 2


@cache
def quadrature(degree: int) -> tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, " Q"]]:
    """Unit directions and weights that integrate every polynomial up to `degree` over the sphere; the weights sum to 4π.

    Gauss–Legendre in z times equal steps of the azimuth. A product of n harmonics of order L has degree n (L − 1).
    """
    z, weight = np.polynomial.legendre.leggauss(degree // 2 + 1)
    angle = 2.0 * np.pi * np.arange(degree + 1) / (degree + 1)
    radius = np.sqrt((1.0 - z) * (1.0 + z))[:, None]
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), z[:, None] + 0 * angle], axis=-1)
    return directions.reshape(-1, 3), np.repeat(weight * 2.0 * np.pi / (degree + 1), degree + 1)


def as_floating(values: Any) -> Array:
    """An array of floating numbers; integers become float64."""
    values = jnp.asarray(values)
    return values if jnp.issubdtype(values.dtype, jnp.floating) else values.astype(jnp.float64)
