"""Naive hair: lobes as printed, or as Gaussians, slopes that cancel, lobes left out, fixed steps, strands unchecked."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.stability.mutants import mutant
from prt_bench.stability.routes import F32, F64

_LOBE = "prt_bench.hair:longitudinal"
_CROSSING = "prt_bench.hair:crossing"


@mutant("the longitudinal lobe as printed", _LOBE, "longitudinal lobes", routes=(F64, F32))
def as_printed(_: Any) -> Any:
    """Infinity times nothing where the variance is small."""

    def naive(into: Any, out: Any, variance: Any) -> Any:
        bessel = jax.scipy.special.i0(jnp.asarray(into.cosine * out.cosine / variance))
        return jnp.exp(-into.sine * out.sine / variance) * bessel / (2 * variance * jnp.sinh(1 / variance))

    return naive


@mutant("a Gaussian of the inclination", _LOBE, "longitudinal lobes")
def gaussian(_: Any) -> Any:
    """Normalised over all real numbers, of which a wide lobe has only a part."""

    def naive(into: Any, out: Any, variance: Any) -> Any:
        turn = jnp.arctan2(into.sine, into.cosine) + jnp.arctan2(out.sine, out.cosine)
        return jnp.exp(-0.5 * turn**2 / variance) / jnp.sqrt(2 * jnp.pi * variance) / into.cosine

    return naive


@mutant("1 − cos(θ_i + θ_o) by subtraction", _LOBE, "longitudinal lobes", routes=(F32,))
def cancelled(_: Any) -> Any:
    """The width of a narrow lobe is lost in rounding."""

    def naive(into: Any, out: Any, variance: Any) -> Any:
        product = jnp.asarray(into.cosine * out.cosine)
        exponent = (product - into.sine * out.sine - 1) / variance
        scaled = jax.scipy.special.i0e(product / variance) * jnp.exp(exponent)
        return scaled / (variance * -jnp.expm1(-2 / variance))

    return naive


@mutant(
    "the slope of exp(−x) I₀(x) as a difference", "prt_bench.hair:scaled_bessel", "longitudinal lobes", routes=(F32,)
)
def difference(_: Any) -> Any:
    """exp(−x) I₁(x) and exp(−x) I₀(x) agree in all digits where x is large."""
    return jax.scipy.special.i0e


@mutant("no light that goes round more often", _CROSSING, "white fibres", "paths among", routes=(F64, F32))
def three_lobes(sound: Any) -> Any:
    """White fibres absorb what their fourth lobe would give back."""

    def naive(*arguments: Any) -> Any:
        found = sound(*arguments)
        return found._replace(weights=found.weights * np.array([1.0, 1.0, 1.0, 0.0])[:, None])

    return naive


@mutant("no Fresnel term on the way through", _CROSSING, "white fibres", routes=(F64,))
def unreflected(sound: Any) -> Any:
    """What was reflected goes through as well."""

    def naive(*arguments: Any) -> Any:
        found = sound(*arguments)
        lost = (1.0 - found.weights[:, :1]) ** 2
        through = found.weights / np.where(np.arange(4)[:, None] == 1, np.maximum(lost, 1e-12), 1.0)
        return found._replace(weights=through)

    return naive


@mutant("a fixed step out of fibres", "data_gen.hair_paths:StrandPaths._outside", "paths among", routes=(F32,))
def fixed_step(_: Any) -> Any:
    """5 cm in every scene."""

    def naive(self: Any, strand: Any, position: Any, tangent: Any, direction: Any) -> Any:
        across = direction - np.einsum("nd,nd->n", direction, tangent)[:, None] * tangent
        return position + 0.05 * across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)

    return naive


@mutant("strands unchecked", "prt_bench.strands:Strands.__post_init__", "strands without", routes=(F64,))
def unchecked(_: Any) -> Any:
    """Tangents are 0 / 0."""
    return lambda self: None


@mutant("the sine around a fibre without a floor", "prt_bench.emitters:strength", "a light on a fibre")
def bare_root(sound: Any) -> Any:
    """An infinite slope along the fibre."""

    def naive(emitters: Any, position: Any, normal: Any, fibre: Any = None) -> Any:
        offset = emitters.position[None, :, :3] - position[:, None]
        away = jnp.sum(offset**2, axis=-1)
        facing = jnp.einsum("pqd,pd->pq", offset, normal) / jnp.sqrt(away)
        return jnp.sqrt(1.0 - facing**2) / jnp.pi / (away + emitters.profile[:, 3])

    return naive
