"""Light as spherical-harmonic coefficients, and back: delta lights, caps, environment maps; values at directions.

Coefficients of C channels are [..., K, C], in the frame of the directions they were given in. Ringing is treated in `windows`.
"""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SpecError
from prt_bench.spherical.harmonics import Real, as_floating, azimuths, count, evaluate, order_of
from prt_bench.spherical.rotation import rotate
from prt_bench.spherical.zonal import cap_lobe, cap_solid_angle, convolve

_MAP_FRAME = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""World axes to those of an environment map, z its pole and x at the image's centre (a reflection: φ runs to the right)."""


def delta_light(direction: Real, irradiance: Real, order: int) -> Float[Array, "... K C"]:
    """Light from one unit direction [..., 3] towards it, with irradiance [..., C] at normal incidence: value · y(ω).

    Differentiable in both.
    """
    return evaluate(as_floating(direction), order)[..., :, None] * as_floating(irradiance)[..., None, :]


def cap_light(direction: Real, half_angle: Real | float, radiance: Real, order: int) -> Float[Array, "... K C"]:
    """Radiance [..., C] from a cap about a unit direction [..., 3]: a disc or a sphere light of half-angle [...] in radians.

    A sphere of radius r at distance d has the half-angle arcsin(r/d). Differentiable in all three, at half-angle 0 as well.
    """
    harmonics = convolve(evaluate(as_floating(direction), order), cap_lobe(half_angle, order))
    return harmonics[..., :, None] * (cap_solid_angle(half_angle)[..., None] * as_floating(radiance))[..., None, :]


def project_environment(radiance: Real, order: int) -> Float[Array, "K C"]:
    """Coefficients [K, C] in float64 of an equirectangular map [H, W, C], y up, −z at the centre (as `EnvironmentMap`).

    Exact but for rounding, for radiance constant in every texel: harmonics about the map's pole are a function of the row
    times one of the column, and each is integrated over the texel, not taken at its centre. Then they are turned to z.
    Linear, so differentiable.
    """
    if radiance.ndim != 3:
        raise SpecError(f"an environment map has shape {radiance.shape}, but must be [height, width, channels]")
    rows, columns = _texel_integrals(*radiance.shape[:2], order)
    about_columns = jnp.einsum("hwc,kw->khc", jnp.asarray(radiance, jnp.float64), columns, precision="highest")
    azimuth = azimuths(order)
    about_pole = jnp.einsum("khc,kh->kc", about_columns[azimuth + order - 1], rows, precision="highest")
    return rotate(about_pole, _MAP_FRAME.T)


@lru_cache(maxsize=8)
def _texel_integrals(
    height: int, width: int, order: int
) -> tuple[Float[np.ndarray, "K H"], Float[np.ndarray, "azimuths W"]]:
    """∫ y_lm(θ, 0) sin θ dθ (or of m's cosine partner) over rows, and ∫ cos mφ or sin |m|φ dφ over columns, m from −l to l."""
    count(order)
    span = np.pi / height
    nodes, weight = np.polynomial.legendre.leggauss(8 + int(2 * order * min(1.0, 4.0 / height)))
    theta = (np.arange(height)[:, None] + 0.5 + 0.5 * nodes) * span
    meridian = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    values = np.asarray(evaluate(meridian, order)) * (np.sin(theta) * weight * 0.5 * span)[..., None]
    azimuth = azimuths(order)
    partner = np.arange(order * order) - azimuth + np.abs(azimuth)
    rows = values.sum(axis=1)[:, partner].T
    m = np.arange(1 - order, order)[:, None]
    middle = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * np.pi
    extent = 2.0 * np.pi / width * np.sinc(m / width)
    columns = extent * np.where(m < 0, np.sin(-m * middle), np.cos(m * middle))
    return rows, columns


def reconstruct(coefficients: Real, directions: Real) -> Float[Array, "... C"]:
    """Values [..., C] at unit directions [..., 3] of the function with coefficients [K, C]. Differentiable in both."""
    coefficients, directions = as_floating(coefficients), as_floating(directions)
    harmonics = evaluate(directions, order_of(coefficients.shape[0]))
    return jnp.einsum("...k,kc->...c", harmonics, coefficients, precision="highest")
