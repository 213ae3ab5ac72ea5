"""Zonal functions, symmetric about an axis: what convolving with one multiplies every band by.

The factor of band l is λ_l = 2π ∫ h(t) P_l(t) dt, t the cosine to the axis. Projected at a direction ω, the same function has
the coefficients λ_l y_lm(ω).
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SpecError
from prt_bench.spherical.harmonics import Real, as_floating, bands, count, order_of


def convolve(coefficients: Real, factors: Real, axis: int = -1) -> Array:
    """Every coefficient times the factor of its band. `axis` of the coefficients holds K; keeps their dtype.

    Factors [order], or [..., order] with leading axes that broadcast against those before K when K is the last axis.
    """
    coefficients = as_floating(coefficients)
    order = order_of(coefficients.shape[axis])
    if factors.shape[-1] != order:
        raise SpecError(f"{factors.shape[-1]} factors for coefficients of {order} bands; give one per band")
    each = jnp.asarray(factors, coefficients.dtype)[..., bands(order)]
    return jnp.moveaxis(jnp.moveaxis(coefficients, axis, -1) * each, -1, axis)


def zonal_factors(
    function: Callable[[np.ndarray], np.ndarray], order: int, nodes: int, between: tuple[float, float] = (-1.0, 1.0)
) -> Float[np.ndarray, " order"]:
    """Factors of any function of the cosine, by Gauss–Legendre quadrature with `nodes` points, in float64.

    It vanishes outside `between`, whose ends are put where it has kinks. Exact for polynomials up to degree
    2 · nodes − order.
    """
    count(order)
    t, weight = np.polynomial.legendre.leggauss(nodes)
    low, high = between
    t, weight = 0.5 * (high - low) * t + 0.5 * (high + low), 0.5 * (high - low) * weight
    return 2.0 * np.pi * np.polynomial.legendre.legvander(t, order - 1).T @ (weight * function(t))


def cosine_lobe(order: int) -> Float[np.ndarray, " order"]:
    """Factors of max(cos, 0), which takes radiance to irradiance: π, 2π/3, π/4, 0, −π/24, 0, …

    Ramamoorthi and Hanrahan 2001, by the ratio of consecutive even bands.
    """
    count(order)
    factors, central = np.zeros(max(order, 2)), 1.0
    factors[:2] = np.pi, 2.0 * np.pi / 3.0
    for band in range(2, order, 2):
        central *= (1 - band) / band
        factors[band] = -2.0 * np.pi * central / ((band + 2) * (band - 1))
    return factors[:order]


def phong_lobe(exponent: Real | float, order: int) -> Float[Array, "... order"]:
    """Factors of the normalised lobe (s + 1)/2π · max(cos, 0)^s, for every exponent s from 0 to infinity.

    λ₀ = 1, λ₁ = (s + 1)/(s + 2), λ_l = λ_{l−2} (s − l + 2)/(s + l + 1), all written in u = 1/(1 + s), so that they are finite
    with their derivatives: s = 0 is the hemisphere, s = ∞ a mirror (all ones, derivative zero). At most 1 in size; bands
    l > s + 2 may be negative, because the rim of a wide lobe is a kink.
    """
    count(order)
    u = 1.0 / (1.0 + as_floating(exponent))
    factors = [jnp.ones_like(u), 1.0 / (1.0 + u)]
    for band in range(2, order):
        factors.append(factors[-2] * ((1.0 + (1 - band) * u) / (1.0 + band * u)))
    return jnp.stack(factors[:order], axis=-1)


def cap_lobe(half_angle: Real | float, order: int) -> Float[Array, "... order"]:
    """Factors of the mean over a spherical cap of a half-angle in [0, π] radians: all ones at 0, the mean alone at π.

    cos²(α/2) P_l′(cos α) / P_l′(1), by steps in multiples of 1 − cos α = 2 sin²(α/2): no difference of neighbours, so the
    sun's cap is as exact as a wide one. Differentiable. Times `cap_solid_angle`, the factors of a cap of height 1.
    """
    count(order)
    angle = as_floating(half_angle)
    cosine, sine = jnp.cos(0.5 * angle) ** 2, jnp.sin(0.5 * angle) ** 2
    ratio, step, factors = jnp.ones_like(angle), jnp.zeros_like(angle), [jnp.ones_like(angle)]
    for band in range(1, order):
        factors.append(cosine * ratio)
        step = ((band - 1) * step - (4 * band + 2) * sine * ratio) / (band + 2)
        ratio = ratio + step
    return jnp.stack(factors, axis=-1)


def cap_solid_angle(half_angle: Real | float) -> Float[Array, "..."]:
    """2π (1 − cos α) in steradians, without the cancellation of small caps. A sphere of radius r at d has sin α = r/d."""
    return 4.0 * jnp.pi * jnp.sin(0.5 * as_floating(half_angle)) ** 2
