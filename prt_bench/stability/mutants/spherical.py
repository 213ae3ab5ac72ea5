"""Naive spherical harmonics: factorials, angles, texel centres, ∞/∞, windows that ring, integrals of too few points."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from prt_bench.environment import texel_directions
from prt_bench.spherical import harmonics
from prt_bench.stability.mutants import mutant
from prt_bench.stability.routes import F32, F64

_EVALUATE = "prt_bench.spherical.harmonics:evaluate"
_BLOCKS = "prt_bench.spherical.rotation:rotation_blocks"
_WINDOW = "prt_bench.spherical.windows:positive"
_PHONG = "prt_bench.spherical.zonal:phong_lobe"
_TRIPLES = "prt_bench.spherical.products:triple_products"
_MAP = "prt_bench.spherical.projection:project_environment"


@mutant("harmonics by factorials", _EVALUATE, "harmonics of high order", routes=(F32,))
def by_factorials(sound: Any) -> Any:
    """(2l)! overflows float32 from l = 18 on."""

    def naive(directions: Any, order: int) -> Any:
        found = sound(directions, order)
        band, m = harmonics.bands(order), np.abs(harmonics.azimuths(order))
        exact = np.cumsum(np.log(np.maximum(np.arange(2 * order), 1)))
        factorial = jnp.cumprod(jnp.maximum(jnp.arange(2 * order), 1).astype(found.dtype))
        naive, right = (
            jnp.sqrt(factorial[band - m] / factorial[band + m]),
            np.exp(0.5 * (exact[band - m] - exact[band + m])),
        )
        return found * (naive / right).astype(found.dtype)

    return naive


@mutant("harmonics of angles", _EVALUATE, "harmonics at the poles")
def of_angles(sound: Any) -> Any:
    """An azimuth has no derivative at a pole, an arc cosine neither."""

    def naive(directions: Any, order: int) -> Any:
        x, y, z = jnp.moveaxis(jnp.asarray(directions), -1, 0)
        polar, azimuth = jnp.arccos(z), jnp.arctan2(y, x)
        again = (jnp.sin(polar) * jnp.cos(azimuth), jnp.sin(polar) * jnp.sin(azimuth), jnp.cos(polar))
        return sound(jnp.stack(again, axis=-1), order)

    return naive


@mutant("the phase of Condon and Shortley", _EVALUATE, "harmonics of high order")
def with_phase(sound: Any) -> Any:
    """Another convention than the lights were projected in."""
    return lambda directions, order: sound(directions, order) * (-1.0) ** harmonics.azimuths(order)


@mutant("rotations by Euler angles", _BLOCKS, "rotations where angles lock")
def by_euler_angles(sound: Any) -> Any:
    """Locks where the pole keeps its place."""

    def naive(rotation: Any, order: int) -> Any:
        r = jnp.asarray(rotation)
        first, turn, last = (
            jnp.arctan2(r[..., 1, 2], r[..., 0, 2]), jnp.arccos(r[..., 2, 2]), jnp.arctan2(r[..., 2, 1], -r[..., 2, 0])
        )  # fmt: skip
        return sound(_about_z(first) @ _about_y(turn) @ _about_z(last), order)

    return naive


def _about_z(angle: Any) -> Any:
    c, s, zero = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)
    return jnp.stack([jnp.stack(row, -1) for row in ((c, -s, zero), (s, c, zero), (zero, zero, zero + 1))], -2)


def _about_y(angle: Any) -> Any:
    c, s, zero = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)
    return jnp.stack([jnp.stack(row, -1) for row in ((c, zero, s), (zero, zero + 1, zero), (-s, zero, c))], -2)


@mutant("rotations the other way", _BLOCKS, "rotations where angles lock", routes=(F64,))
def transposed(sound: Any) -> Any:
    """World to local for local to world; orthogonal all the same."""
    return lambda rotation, order: sound(jnp.swapaxes(jnp.asarray(rotation), -1, -2), order)


@mutant("no window", _WINDOW, "delta lights under")
def no_window(_: Any) -> Any:
    """Rings below zero."""
    return lambda order: np.ones(order)


@mutant("a raised cosine for the positive window", _WINDOW, "delta lights under")
def raised_cosine(_: Any) -> Any:
    """Rings less, and below zero still."""
    return lambda order: 0.5 * (1.0 + np.cos(np.pi * np.arange(order) / order))


@mutant("a window that dims", _WINDOW, "delta lights under")
def dimming(sound: Any) -> Any:
    """Light is lost."""
    return lambda order: 0.99 * sound(order)


@mutant("the printed recursion of Phong lobes", _PHONG, "Phong lobes")
def printed_phong(_: Any) -> Any:
    """∞/∞ for a mirror."""

    def naive(exponent: Any, order: int) -> Any:
        s = jnp.asarray(exponent)
        found = [jnp.ones_like(s), (s + 1) / (s + 2)]
        for band in range(2, order):
            found.append(found[-2] * (s - band + 2) / (s + band + 1))
        return jnp.stack(found[:order], axis=-1)

    return naive


@mutant("Phong lobes as Gaussians", _PHONG, "Phong lobes")
def gaussian(_: Any) -> Any:
    """Right for sharp lobes alone."""
    return lambda exponent, order: jnp.exp(-(np.arange(order) ** 2) / (2.0 * jnp.asarray(exponent) + 1e-6))


@mutant("caps by differences of Legendre polynomials", "prt_bench.spherical.zonal:cap_lobe", "caps from points")
def by_differences(_: Any) -> Any:
    """Cancels for the sun, and is 0/0 for a point."""

    def naive(half_angle: Any, order: int) -> Any:
        cosine = jnp.cos(jnp.asarray(half_angle))
        values = [jnp.ones_like(cosine), cosine]
        for band in range(2, order + 1):
            values.append(((2 * band - 1) * cosine * values[-1] - (band - 1) * values[-2]) / band)
        parts = [(values[band - 1] - values[band + 1]) / ((2 * band + 1) * (1 - cosine)) for band in range(1, order)]
        return jnp.stack([jnp.ones_like(cosine), *parts], axis=-1)

    return naive


def _resampled(sound: Any, points: Callable[[int], tuple[np.ndarray, np.ndarray]]) -> Any:
    """The entries of small tensors integrated again, with other points and weights."""

    def naive(order: int) -> Any:
        found = sound(order)
        if order > 5:
            return found
        directions, weight = points(order)
        i, j, k = np.asarray(harmonics.evaluate(directions, order))[:, found.indices.T].swapaxes(0, 1)
        return found._replace(values=weight @ (i * j * k))

    return naive


@mutant("triple products by too few points", _TRIPLES, "triple products", routes=(F64,))
def too_few_points(sound: Any) -> Any:
    """Exact for products of two."""
    return _resampled(sound, lambda order: harmonics.quadrature(2 * (order - 1)))


@mutant("triple products by random points", _TRIPLES, "triple products", routes=(F64,))
def random_points(sound: Any) -> Any:
    """An error of the root of their number."""
    drawn = np.random.default_rng(0).normal(size=(512, 3))
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    return _resampled(sound, lambda _: (drawn, np.full(512, 4 * np.pi / 512)))


@mutant("triple products without their permutations", _TRIPLES, "triple products", routes=(F64,))
def unpermuted(sound: Any) -> Any:
    """Sorted indices alone: half of a product is missing."""

    def naive(order: int) -> Any:
        found = sound(order)
        kept = np.all(np.diff(found.indices, axis=1) >= 0, axis=1)
        return type(found)(found.indices[kept], found.values[kept])

    return naive


def _at_centres(radiance: Any, order: int, solid_angle: Any) -> Any:
    direction, _ = texel_directions(*radiance.shape[:2])
    return jnp.einsum("hwk,hwc->kc", harmonics.evaluate(direction, order), jnp.asarray(radiance) * solid_angle)


@mutant("maps at the centres of texels", _MAP, "environment maps with")
def at_centres(_: Any) -> Any:
    """An error of the square of the texel."""
    return lambda radiance, order: _at_centres(radiance, order, texel_directions(*radiance.shape[:2])[1][..., None])


@mutant("maps without sin θ", _MAP, "environment maps with")
def without_sine(_: Any) -> Any:
    """Poles are as bright as the equator."""
    return lambda radiance, order: _at_centres(radiance, order, 4 * np.pi / np.prod(radiance.shape[:2]))


@mutant("maps added up in float32", _MAP, "environment maps with")
def in_float32(sound: Any) -> Any:
    """A sun hides what is added after it."""

    def naive(radiance: Any, order: int) -> Any:
        parts = [sound(jnp.zeros(radiance.shape).at[row].set(radiance[row]), order) for row in range(len(radiance))]
        return sum(part.astype(jnp.float32) for part in parts)

    return naive
