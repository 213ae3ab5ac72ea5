"""Naive light and rays: unclamped sources, series cut short, fixed offsets, back faces, seams, one range for all bases."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.stability.mutants import mutant
from prt_bench.stability.routes import F32, F64

_STRENGTH = "prt_bench.emitters:strength"
_INDIRECT = "prt_bench.transport:indirect"
_BOUNDS = "prt_bench.transport:tail_bounds"


@mutant("point lights without a radius", _STRENGTH, "light on a surface", subject="PointLight")
def unclamped(sound: Any) -> Any:
    """1 / r² at contact."""
    return lambda emitters, position, normal: sound(
        type(emitters)(emitters.position, emitters.axis, emitters.intensity, emitters.profile.at[:, 3].set(0.0)),
        position, normal,
    )  # fmt: skip


@mutant("a fixed floor under r²", _STRENGTH, "scenes of any size", subject="PointLight")
def fixed_radius(sound: Any) -> Any:
    """A length in metres that no scene asked for."""
    return lambda emitters, position, normal: sound(
        type(emitters)(emitters.position, emitters.axis, emitters.intensity, emitters.profile.at[:, 3].set(0.01)),
        position, normal,
    )  # fmt: skip


@mutant("light from behind", _STRENGTH, "irradiance adds up", subject="EnvironmentLight")
def from_behind(sound: Any) -> Any:
    """A cosine that may be negative."""
    return lambda emitters, position, normal: sound(emitters, position, normal) - sound(emitters, position, -normal)


@mutant("lights unchecked", "prt_bench.lights:_check", "unphysical lights", routes=(F64,))
def unchecked(_: Any) -> Any:
    """Negative and infinite light is baked."""
    return lambda light, **ranges: None


@mutant("median cut of scalar energy", "prt_bench.environment:median_cut", "environment maps")
def scalar_energy(sound: Any) -> Any:
    """Brighter than the sky it stands for."""
    return lambda environment, count: (lambda d, e: (d, e * 1.01))(*sound(environment, count))


@mutant("64 bounces for every scene", _INDIRECT, "all bounces")
def too_few_bounces(sound: Any) -> Any:
    """Half of the energy is lost at an albedo of 0.99."""
    return lambda gather, albedo, direct, bounces: sound(gather, albedo, direct, min(bounces, 64))


@mutant("the last bounce for a bound", _BOUNDS, "all bounces")
def last_bounce(sound: Any) -> Any:
    """Forgets all bounces but the next."""

    def naive(gather: Any, albedo: Any, most: int) -> Any:
        bounds = sound(gather, albedo, most)
        return np.append(bounds[:-1] - bounds[1:], 0.0)

    return naive


@mutant("no refusal of albedo 1", _BOUNDS, "closed box")
def no_refusal(_: Any) -> Any:
    """A bound of zero for a series that diverges."""
    return lambda gather, albedo, most: np.zeros(most)


@mutant("rows over the rays that hit", "prt_bench.transport:_gather", "rows sum", "one firefly")
def renormalised(sound: Any) -> Any:
    """Light that escapes comes back."""

    def naive(hits: Any, adjoint: Any, padded: Any) -> Any:
        carrying = jnp.mean(hits < padded.shape[0] - 2, axis=1)[:, None].astype(padded.dtype)
        return sound(hits, adjoint, padded) / jnp.maximum(carrying, 1e-6) * (carrying > 0) + 0 * padded[:1]

    return naive


@mutant("gathered in half precision", "prt_bench.transport:_gather", "one firefly", "rows sum")
def in_half_precision(sound: Any) -> Any:
    """Overflows beside a firefly, and rounds the rest away."""
    return lambda hits, adjoint, padded: sound(hits, adjoint, padded.astype(jnp.float16).astype(padded.dtype))


@mutant("albedo held fixed in derivatives", _INDIRECT, "bounces in albedo", subject="gather")
def fixed_albedo(sound: Any) -> Any:
    """Albedo cannot be learned."""
    return lambda gather, albedo, direct, bounces: sound(gather, jax.lax.stop_gradient(albedo), direct, bounces)


@mutant("fixed ray offset", "data_gen.tracer:Tracer.__init__", "hits at any", "a near occluder", routes=(F32,))
def fixed_offset(sound: Any) -> Any:
    """1e-4 metres in every scene."""

    def naive(self: Any, *arguments: Any) -> None:
        sound(self, *arguments)
        self.offset = 1e-4

    return naive


@mutant("no ray offset", "data_gen.tracer:Tracer.__init__", "hits at any", "a near occluder", routes=(F32,))
def no_offset(sound: Any) -> Any:
    """Surfaces hit themselves."""

    def naive(self: Any, *arguments: Any) -> None:
        sound(self, *arguments)
        self.offset = 0.0

    return naive


@mutant("back faces reflect", "data_gen.resolve:HitResolver.__call__", "back faces", "nothing is looked", routes=(F32,))
def back_faces(sound: Any) -> Any:
    """Light from the inside of closed bodies."""

    def naive(self: Any, *arguments: Any) -> Any:
        turned = replace(self, face=(*self.face[:7], *(-axis for axis in self.face[7:])))
        fronts, backs = sound(self, *arguments), sound(turned, *arguments)
        return np.where(fronts < self.samples, fronts, backs)

    return naive


@mutant("hits interpolated over seams", "data_gen.resolve:HitResolver.__call__", "nothing is looked", routes=(F32,))
def over_seams(sound: Any) -> Any:
    """Light leaks from one chart into the next."""

    def naive(self: Any, *arguments: Any) -> Any:
        one_chart = (*self.face[:6], jnp.zeros_like(self.face[6]), *self.face[7:])
        return sound(replace(self, face=one_chart, chart=jnp.zeros_like(self.chart)), *arguments)

    return naive


@mutant("texture coordinates as they come", "data_gen.atlas:_flaw_of_own_atlas", "texture coordinates", routes=(F64,))
def as_they_come(sound: Any) -> Any:
    """Islands that overlap receive each other's light."""
    return lambda scene, resolution: sound(scene, resolution) if scene.mesh.uv is None else None


@mutant("bad pixels kept", "prt_bench.environment:_bad", "environment maps with bad pixels", routes=(F64,))
def bad_pixels_kept(_: Any) -> Any:
    """One of them is all the light there is."""
    return lambda radiance: np.zeros(radiance.shape, bool)


@mutant("8-bit bases of one global range", "prt_bench.models:Model.export", "quantised bases", routes=(F64,))
def one_range(sound: Any) -> Any:
    """The small functions are lost beside the large one."""

    def naive(self: Any, path: Any, dtype: str = "float32") -> Any:
        step = jnp.maximum(jnp.abs(self.basis).max(), 1e-30) / 127
        return sound(type(self)(jnp.round(self.basis / step) * step, self.weights), path, dtype)

    return naive


@mutant("overflow clipped", "prt_bench.models:Model.export", "weights that do not", routes=(F64,))
def clipped(sound: Any) -> Any:
    """Another basis than the one that was fitted."""

    def naive(self: Any, path: Any, dtype: str = "float32") -> Any:
        most = float(np.finfo(dtype).max) / 2
        basis = jnp.clip(jnp.nan_to_num(self.basis), -most, most)
        return sound(type(self)(basis, self.weights), path, dtype)

    return naive


@mutant("walks of 64 steps", "data_gen.medium_walk:LONGEST", "walks end")
def short_walks(_: Any) -> Any:
    """Deep media lose what has not come out yet."""
    return 64


@mutant("free paths by -log u", "data_gen.medium_walk:free_paths", "free paths")
def infinite_paths(_: Any) -> Any:
    """Infinite at u = 0, which is drawn."""
    return lambda u, extinction: -np.log(u) / extinction


@mutant("the phase function divided by its anisotropy", "data_gen.medium_walk:scattered", "narrow phase")
def isotropic_division(sound: Any) -> Any:
    """0 / 0 where scattering is isotropic."""

    def naive(direction: Any, g: float, first: Any, second: Any) -> Any:
        cosine = (1 + g * g - ((1 - g * g) / (1 + g - 2 * g * first)) ** 2) / (2 * np.float64(g))
        return sound(direction, g, first, second) if np.all(np.isfinite(cosine)) else direction * np.nan

    return naive


@mutant("media in open bodies", "data_gen.effects.subsurface:check_closed", "a medium needs")
def open_bodies(_: Any) -> Any:
    """Walks leave through the hole."""
    return lambda scene, material: None


@mutant("a signed power", "prt_bench.gamma:curve", "slope of gamma")
def signed_power(_: Any) -> Any:
    """Infinitely steep at black."""
    return lambda v, gamma, toe=0.0: jnp.sign(v) * jnp.abs(v) ** (1.0 / gamma)


@mutant("a power of negative light", "prt_bench.gamma:curve", "gamma of light")
def bare_power(_: Any) -> Any:
    """NaN below zero."""
    return lambda v, gamma, toe=0.0: v ** (1.0 / gamma)
