"""Glossy reflection from transfer vectors by triple products: view-dependent light from K numbers per texel.

A texel's transfer vector T are the coefficients of visibility times cosine; the product with the light L is what arrives
from every direction and weighs there; a normalised Phong lobe about the mirror direction ω_r of the view reads it off:

    B(ω_r) = Σ_k λ_k(s) y_k(ω_r) Σ_ij Γ_ijk T_i L_j   W/m²/sr, times the specular reflectance.

Γ is symmetric, so the sum over T and the lobe can be taken first, once for all colours: B = L · q, q = product(T, λ y(ω_r)).
"""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import FitError
from prt_bench.harmonic import HarmonicModel
from prt_bench.spherical import bands, evaluate, phong_lobe, product, product_matrix


class Surface(NamedTuple):
    """What T points reflect: unit normal, diffuse albedo, specular reflectance (linear RGB) and Phong exponent."""

    normal: Float[np.ndarray, "T 3"]
    albedo: Float[np.ndarray, "T 3"]
    specular: Float[np.ndarray, "T 3"]
    exponent: Float[np.ndarray, " T"]


def mirrored(towards_eye: Float[Array, "T 3"], normal: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
    """The mirror direction of the view about the normal."""
    return 2.0 * jnp.sum(towards_eye * normal, axis=-1, keepdims=True) * normal - towards_eye


class TripleModel(HarmonicModel):
    """basis [T, W, K]: transfer vectors of diffuse light for each channel, then the grey one of direct light for the lobes.

    W is 1 without inter-reflections, where one vector serves both. Irradiance is that of `HarmonicModel`.
    """

    kernels: ClassVar[dict[str, str]] = {**HarmonicModel.kernels, "reconstruct": "triple"}

    @property
    def diffuse(self) -> HarmonicModel:
        """The vectors of diffuse light."""
        return HarmonicModel(self.basis if self.basis.shape[1] == 1 else self.basis[:, :-1], self.centre)

    def reconstruct(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Irradiance, as `sh-texture` has it."""
        return self.diffuse.reconstruct(u)

    def lobe(self, mirror: Float[Array, "T 3"], exponent: Float[Array, " T"]) -> Float[Array, "T K"]:
        """λ_k(s) y_k(ω_r): coefficients of the lobe that looks along `mirror`."""
        return phong_lobe(exponent, self.order)[..., bands(self.order)] * evaluate(mirror, self.order)

    def gloss(
        self, u: Float[Array, "N K C"], mirror: Float[Array, "T 3"], exponent: Float[Array, " T"]
    ) -> Float[Array, "N T C"]:
        """B(ω_r): what the lobes reflect of direct light, per unit of specular reflectance, W/m²/sr.

        Negative where the light's frequency is cut; differentiable in the light and the exponent.
        """
        q = product(self.basis[:, -1], self.lobe(mirror, exponent))
        return jnp.einsum("tk,nkc->ntc", q, u, precision="highest")

    def radiance(
        self, u: Float[Array, "N K C"], surface: Surface, towards_eye: Float[Array, "T 3"]
    ) -> Float[Array, "N T C"]:
        """Reflected radiance towards the eye, W/m²/sr: diffuse, and the lobe where it is not negative."""
        lobe = self.gloss(u, mirrored(towards_eye, jnp.asarray(surface.normal)), jnp.asarray(surface.exponent))
        return jnp.asarray(surface.albedo) / jnp.pi * self.reconstruct(u) + surface.specular * jnp.maximum(lobe, 0.0)


class FixedTripleModel(TripleModel):
    """The same with the light fixed for a frame: B = Tᵀ M (λ y(ω_r)), with a matrix M_ik = Σ_j Γ_ijk L_j for each channel."""

    kernels: ClassVar[dict[str, str]] = {**HarmonicModel.kernels, "reconstruct": "triple-fixed"}

    def gloss(
        self, u: Float[Array, "N K C"], mirror: Float[Array, "T 3"], exponent: Float[Array, " T"]
    ) -> Float[Array, "N T C"]:
        """As `TripleModel`, by the matrices of the light."""
        matrices = product_matrix(jnp.moveaxis(u, 1, 2))
        pair = self.basis[:, -1], self.lobe(mirror, exponent)
        return jnp.einsum("ti,ncik,tk->ntc", pair[0], matrices, pair[1], precision="highest")


class BouncedTripleModel(TripleModel):
    """Direct light of any lighting, and inter-reflections of one that is fixed: basis [T, 1 + C, K].

    The first vector is the direct one. The others are coefficients of the radiance that surfaces send, times the cosine, in
    W/m²/sr for each channel: they hold light already, so neither light nor materials of the scene may change. Lobes read
    them off as they read the product of light and transfer, and their first coefficient is irradiance.
    """

    kernels: ClassVar[dict[str, str]] = {**HarmonicModel.kernels, "reconstruct": "triple-bounced"}

    @property
    def diffuse(self) -> HarmonicModel:
        """The vectors of direct light."""
        return HarmonicModel(self.basis[:, :1], self.centre)

    def reconstruct(self, u: Float[Array, "N K C"]) -> Float[Array, "N T C"]:
        """Irradiance of direct light under `u`, and of what is sent under the fixed light."""
        return self.diffuse.reconstruct(u) + jnp.sqrt(4.0 * jnp.pi) * self._sent(u)[:, :, 0]

    def gloss(
        self, u: Float[Array, "N K C"], mirror: Float[Array, "T 3"], exponent: Float[Array, " T"]
    ) -> Float[Array, "N T C"]:
        """As `TripleModel`, and what the lobes reflect of surfaces."""
        lobe = self.lobe(mirror, exponent)
        q = product(self.basis[:, 0], lobe)
        direct = jnp.einsum("tk,nkc->ntc", q, u, precision="highest")
        return direct + jnp.einsum("tk,tck->tc", lobe, self._sent(u), precision="highest")

    def _sent(self, u: Float[Array, "N K C"]) -> Float[Array, "T C K"]:
        if self.basis.shape[1] != 1 + u.shape[2]:
            raise FitError(
                f"the model holds light in {self.basis.shape[1] - 1} channels, but the light has {u.shape[2]}"
            )
        return self.basis[:, 1:]
