"""Indirect light by direction: what glossy surfaces need beyond irradiance, as nine SH coefficients a receiver.

    c_k = ∫ L(ω) max(n · ω, 0) y_k(ω) dω,    c_0 √(4π) = irradiance,

and a normalised Phong lobe of exponent s about the mirror direction ω_r of the view reads off what it reflects of them,
Σ_k λ_k(s) y_k(ω_r) c_k, per unit of specular reflectance (Ng et al. 2004 fold the cosine into transfer in the same way; cf.
Sloan et al. 2002, "Precomputed Radiance Transfer", Section 5). Three bands blur a lobe sharper than s ≈ 4. Coefficients
are made by `data_gen/effects/directional.py`, and drawn by `runtime/glossy_indirect.py`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from prt_bench.spherical import bands, evaluate, phong_lobe

ORDER = 3
"""Bands that are kept."""
COEFFICIENTS = ORDER**2


def gloss(
    coefficients: Float[Array, "N G K C"], mirror: Float[Array, "G 3"], exponent: Float[Array, " G"]
) -> Float[Array, "N G C"]:
    """Radiance that lobes about the unit directions `mirror` reflect, per unit of specular reflectance, W/m²/sr.

    Negative where three bands overshoot. Linear in the coefficients, differentiable in all arguments.
    """
    lobe = phong_lobe(exponent, ORDER)[..., bands(ORDER)] * evaluate(mirror, ORDER)
    return jnp.einsum("gk,ngkc->ngc", lobe, coefficients, precision="highest")


def irradiance(coefficients: Float[Array, "N G K C"]) -> Float[Array, "N G C"]:
    """The irradiance that the coefficients hold, W/m²."""
    return jnp.sqrt(4.0 * jnp.pi) * coefficients[:, :, 0]
