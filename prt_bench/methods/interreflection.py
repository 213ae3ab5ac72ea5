"""Inter-reflections under light that is fixed: what lit surfaces send to each point, glossy reflection included.

`fix_light` sends radiance bounce by bounce along the traced rays: at every hit a surface reflects what it received towards
the point the ray came from, and what arrives there is projected on harmonics again. Diffuse bounces of any light are columns
of the operator and live in `escaping.py`; what is stored and shown is in `prt_bench.glossy`.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.dataset import LightingDataset, Transport
from prt_bench.emitters import Emitters
from prt_bench.errors import SpecError
from prt_bench.glossy import BouncedTripleModel, Surface, mirrored
from prt_bench.harmonic import light_coefficients
from prt_bench.lights import Lighting, emitters
from prt_bench.methods.escaping import direct_transfer
from prt_bench.spherical import bands, evaluate, order_of, phong_lobe, product_matrix

_RAYS = 1 << 16  # rays whose harmonics are in memory at once
_SQRT_4PI = float(np.sqrt(4.0 * np.pi))


def fix_light(ds: LightingDataset, lighting: Lighting, order: int = 5, bounces: int = 2) -> BouncedTripleModel:
    """Transfer textures with the light fixed: direct vectors for any light, and `bounces` ≥ 1 of inter-reflections of this one.

    After that many reflections light is lost; diffuse surfaces and lobes see all that was sent before, by lobes too. The light
    is cut to `order` bands, as everywhere. Needs the transport alone; a closed scene has no distant light and gives zeros.
    """
    if not 1 <= order <= 8:
        raise SpecError(f"order is {order}, but a triple product needs one from 1 to 8")
    centre = jnp.asarray(ds.transport.scene.bounds.mean(axis=0))
    lights: Emitters = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64)[0], emitters([lighting]))
    light = light_coefficients(lights, centre, order)
    return BouncedTripleModel(jnp.asarray(bounced_transfer(ds.transport, np.asarray(light), bounces)), centre)


def bounced_transfer(
    transport: Transport, light: Float[np.ndarray, "K C"], bounces: int
) -> Float[np.ndarray, "T 1+C K"]:
    """Basis of a `BouncedTripleModel` under light of the given coefficients, W/m²/sr.

    Source: transfer textures, Section 4.2, which stores a texture for each bounce; their sum is all that is shown.
    """
    if bounces < 1:
        raise SpecError(f"bounces is {bounces}, but must be at least 1; sh-triple shows direct light alone")
    if transport.scene.translucent:
        raise SpecError(
            f"'{transport.scene.name}' has translucent bodies, which bounces of fixed light do not enter; use sh-triple"
        )
    order, traced = order_of(len(light)), transport.traced
    shared = traced.receiver_hits is traced.sample_hits
    direct = direct_transfer(traced, traced.receiver_hits, traced.receivers, order)
    at_samples = direct if shared else direct_transfer(transport, transport.sample_hits, transport.samples, order)

    surface = _surface(transport)
    arriving = np.einsum("si,cik->sck", at_samples, product_matrix(light.T))
    irradiance = np.einsum("sk,kc->sc", at_samples, light)
    total = np.zeros((len(direct), light.shape[1], len(light)), np.float32)
    for bounce in range(bounces):
        sent = (surface, jnp.asarray(irradiance, jnp.float32), jnp.asarray(arriving, jnp.float32))
        received = _project(traced, traced.receiver_hits, traced.receivers.normal, sent, order)
        total += received
        if bounce + 1 < bounces:
            normal = transport.samples.normal
            arriving = received if shared else _project(transport, transport.sample_hits, normal, sent, order)
            irradiance = arriving[:, :, 0] * _SQRT_4PI
    return transport.spread(np.concatenate([direct[:, None], total], axis=1))


def _surface(transport: Transport) -> Surface:
    """What the gather samples reflect."""
    samples = transport.samples
    specular, exponent = transport.scene.glossy_at(samples.face, samples.barycentric)
    columns = (samples.normal, samples.albedo, specular, exponent)
    return Surface(*(jnp.asarray(column, jnp.float32) for column in columns))  # pyright: ignore[reportArgumentType]


def _project(
    transport: Transport, table: Any, normal: Float[np.ndarray, "P 3"], sent: tuple, order: int
) -> Float[np.ndarray, "P C K"]:
    """Coefficients of the radiance that arrives from the samples at the points of a hit table, times the cosine, W/m²/sr."""
    assert transport.sampler is not None
    rays = table.shape[1]
    step = max(_RAYS // rays, 1)
    out = np.empty((len(normal), sent[1].shape[1], order**2), np.float32)
    for at in range(0, len(normal), step):
        rows = slice(at, min(at + step, len(normal)))
        directions = transport.sampler.directions(at, normal[rows])
        hits = np.minimum(np.asarray(table[rows], np.int32), len(transport.samples))
        short = step - len(hits)  # one shape to compile for
        directions = np.pad(directions, ((0, short), (0, 0), (0, 0)), constant_values=0.5)
        hits = np.pad(hits, ((0, short), (0, 0)), constant_values=len(transport.samples))
        out[rows] = _arriving(*sent, hits, directions, order=order)[: step - short]
    return out


@partial(jax.jit, static_argnames="order")
def _arriving(
    surface: Surface,
    irradiance: Float[Array, "S C"],
    arriving: Float[Array, "S C K"],
    hits: Int[Array, "p R"],
    directions: Float[Array, "p R 3"],
    *,
    order: int,
) -> Float[Array, "p C K"]:
    """Σ_r L(hit, −ω_r) y_k(ω_r) π/R over rays that meet a sample; `hits` of S carry nothing."""
    carries = hits < len(irradiance)
    met = jnp.minimum(hits, len(irradiance) - 1)
    normal, albedo, specular, exponent = (jnp.asarray(column)[met] for column in surface)
    channels = irradiance.shape[1]
    lobe = phong_lobe(exponent, order)[..., bands(order)] * evaluate(mirrored(-directions, normal), order)
    shine = jnp.maximum(jnp.einsum("prk,prck->prc", lobe, arriving[met]), 0.0)
    radiance = albedo[..., :channels] / jnp.pi * irradiance[met] + specular[..., :channels] * shine
    radiance = jnp.where(carries[..., None], radiance, 0.0)
    scale = jnp.pi / hits.shape[1]
    return scale * jnp.einsum("prc,prk->pck", radiance, evaluate(directions, order))
