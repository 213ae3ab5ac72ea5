"""Punctual emitters, the one form that every light takes, and the unoccluded irradiance they cause.

The bake's shadow rays, the differentiable irradiance below and the GLSL runtime (`shaders/emitters.glsl`) all evaluate
these formulas, so the three agree by construction. Which emitters a light stands for is said in `lights.py`; visibility is
found elsewhere (`data_gen.tracer`, `shaders/shadow.glsl`).
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

EVERYWHERE = (-3.0, -2.0)
"""Cosines of a cone that every direction lies in."""
UP = (0.0, 1.0, 0.0)


class Emitters(eqx.Module):
    """Q punctual emitters (leading axes may batch lightings; padding has zero intensity).

    position [..., Q, 4]: homogeneous; w = 1 is a point, w = 0 a unit direction *towards* the light.
    axis [..., Q, 3]: unit axis of emission. intensity [..., Q, 3]: W/sr along the axis for points, W/m² for directions.
    profile [..., Q, 4]: (cos of the outer cone, cos of the inner cone, weight of the Lambert cosine, squared source radius).
    """

    position: Float[Array, "*N Q 4"]
    axis: Float[Array, "*N Q 3"]
    intensity: Float[Array, "*N Q 3"]
    profile: Float[Array, "*N Q 4"]


def irradiance(
    emitters: Emitters,
    position: Float[Array, "P 3"],
    normal: Float[Array, "P 3"],
    visibility: Bool[Array, "P Q"] | Float[Array, "P Q"] | None = None,
    fibre: Bool[Array, " P"] | None = None,
) -> Float[Array, "P 3"]:
    """Irradiance [P, 3] in W/m² from Q emitters at P points.

    `strength` times intensity, summed over visible emitters. Differentiable in emitters, positions and normals; finite at
    contact because of the source radius r_s.
    """
    weight = strength(emitters, position, normal, fibre)
    if visibility is not None:
        weight = weight * visibility
    return jnp.einsum("pq,qc->pc", weight, emitters.intensity, precision="highest")


def strength(
    emitters: Emitters,
    position: Float[Array, "P 3"],
    normal: Float[Array, "P 3"],
    fibre: Bool[Array, " P"] | None = None,
) -> Float[Array, "P Q"]:
    """Unoccluded irradiance per unit of intensity, for each point and emitter.

    f(c) max(n·ω, 0) / (r² + r_s²) for points and max(n·ω, 0) for directions, with the angular profile
    f(c) = smoothstep(outer, inner, c) · (1 or Lambert's max(c, 0)) of the cosine c to the emission axis.

    On a `fibre` n is the tangent, and sin(n, ω)/π, the mean of the cosine around it, takes the place of max(n·ω, 0).
    """
    w = emitters.position[:, 3]
    offset = emitters.position[None, :, :3] - position[:, None, :] * w[None, :, None]
    distance_squared = jnp.sum(offset**2, axis=-1)
    safe = jnp.maximum(distance_squared, jnp.finfo(distance_squared.dtype).tiny * 1e6)
    direction = offset / jnp.sqrt(safe)[..., None]
    facing = jnp.einsum("pqd,pd->pq", direction, normal)
    incidence = jnp.maximum(facing, 0.0)
    if fibre is not None:
        # The smallest sine is above zero, where its gradient would be infinite.
        around = jnp.sqrt(jnp.maximum(1.0 - facing**2, 1e-12)) / jnp.pi
        incidence = jnp.where(fibre[:, None], around, incidence)

    outer, inner, lambert, radius_squared = jnp.moveaxis(emitters.profile, -1, 0)
    cosine = -jnp.einsum("pqd,qd->pq", direction, emitters.axis)
    t = jnp.clip((cosine - outer) / jnp.maximum(inner - outer, 1e-6), 0.0, 1.0)
    profile = t * t * (3.0 - 2.0 * t) * (1.0 + lambert * (jnp.maximum(cosine, 0.0) - 1.0))
    return incidence * profile / jnp.where(w > 0, distance_squared + radius_squared, 1.0)


def point_emitters(
    position: Any, axis: Any, intensity: Any, cone: tuple[Any, Any], lambert: float, radius: Any
) -> Emitters:
    """Points [Q, 3] that emit along `axis` ([3] or [Q, 3]) and share a cone, a weight of the Lambert cosine and a radius."""
    count = position.shape[0]
    row = jnp.stack([jnp.asarray(value, float) for value in (*cone, lambert, radius**2)])
    return Emitters(
        jnp.concatenate([position, jnp.ones((count, 1))], axis=1),
        jnp.broadcast_to(jnp.asarray(axis, float), (count, 3)),
        jnp.asarray(intensity, float),
        jnp.broadcast_to(row, (count, 4)),
    )


def directional_emitters(towards_light: Any, irradiance: Any) -> Emitters:
    """Unit directions towards the light [Q, 3], each with the irradiance [Q, 3] it causes at normal incidence."""
    direction = jnp.asarray(towards_light, float)
    count = direction.shape[0]
    return Emitters(
        jnp.concatenate([direction, jnp.zeros((count, 1))], axis=1),
        -direction,
        jnp.asarray(irradiance, float),
        jnp.broadcast_to(jnp.asarray([*EVERYWHERE, 0.0, 0.0]), (count, 4)),
    )


def darkness(count: int) -> Emitters:
    """Emitters of zero intensity."""
    return directional_emitters(jnp.broadcast_to(jnp.asarray(UP), (count, 3)), jnp.zeros((count, 3)))


def joined(parts: Sequence[Emitters]) -> Emitters:
    """The emitters of several lights as those of one lighting."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def batched(lightings: Sequence[Emitters]) -> Emitters:
    """The emitters of N lightings as [N, Q, …], padded with darkness."""
    most = max(part.position.shape[0] for part in lightings)
    missing = [most - part.position.shape[0] for part in lightings]
    padded = [joined([part, darkness(n)]) if n else part for part, n in zip(lightings, missing, strict=True)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)
