"""From lights to indirect light as functions of lights and albedo: what the gradients of a design run through.

| from | to | by |
|---|---|---|
| lights (position, direction, intensity, radiance, cutoff, …) | direct light at points | `direct_light` |
| lights | measured light | `measured_light` |
| measured light | indirect light, by a fitted model | `model.reconstruct(model.transfer(x))` |
| direct light, albedo | indirect light, by the traced operator | `indirect_light` |
| a dataset's light, `ridge`, `prior` | a fitted model, and so its error | `method.fit`, `Method.with_traced` |

Every row is differentiable and held to finite differences (`tests/test_chain.py`, and H1 of `prt-bench stability`).
Gradients do not reach what rays decide: visibility is an argument here, a table of zeros and ones that stays where it is
while a light moves, so the moving edge of a shadow adds nothing to a gradient; nor do they reach hit indices (geometry). Trace
visibility again (`prt.seen`) after a step. Where leave-one-out chooses a setting, the choice is fixed.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from prt_bench.dataset import LightingDataset, Transport
from prt_bench.emitters import irradiance
from prt_bench.lights import Lighting, emitters
from prt_bench.points import SurfacePoints
from prt_bench.transport import final_gather, radiosity, shown
from prt_bench.transport import irradiance as arriving_light

Visibility = Bool[np.ndarray, "N P Q"] | Bool[Array, "N P Q"]


def direct_light(
    points: SurfacePoints, lightings: Sequence[Lighting], visibility: Visibility | None = None
) -> Float[Array, "N P 3"]:
    """Direct irradiance in W/m² at P points under N lightings of at most Q emitters, in the dtype of the lights.

    Without `visibility` nothing casts shadows. Differentiable in the lights.
    """
    at = jnp.asarray(points.position), jnp.asarray(points.normal)
    lit = emitters(lightings)
    fibre = None if points.clearance is None else jnp.asarray(points.clearance > 0)
    if visibility is None:
        return jax.vmap(lambda each: irradiance(each, *at, fibre=fibre))(lit)
    return jax.vmap(lambda each, seen: irradiance(each, *at, seen, fibre))(lit, jnp.asarray(visibility))


def measured_light(
    ds: LightingDataset, lightings: Sequence[Lighting], visibility: Visibility | None = None
) -> Float[Array, "N M 3"]:
    """What the measurement points of `ds` see of other lightings: the mean over each one's dense points, in W/m².

    `visibility` [N, D, Q] is that of `ds.dense_points`. Differentiable in the lights.
    """
    return jnp.mean(direct_light(ds.dense_points, lightings, visibility)[:, ds.groups], axis=2)


def indirect_light(
    transport: Transport, direct: Float[Array, "N S C"], albedo: Float[Array, "S C"]
) -> Float[Array, "N T C"]:
    """Indirect irradiance in W/m² at the receivers, of all bounces, from direct light at the gather samples.

    The traced operator with an `albedo` that may be another than the scene's (`transport.samples.albedo`), in the dtype of
    `direct`. Differentiable in both. All N lightings and all rays are in memory at once.
    """
    gather, within = transport.sample_gather(differentiable=True), transport.sample_scattering(differentiable=True)
    outgoing = radiosity(gather, albedo, direct, transport.bounces - 1, within)
    received = final_gather(transport.traced.receiver_gather(differentiable=True), outgoing)
    if transport.nodes is not None:
        weight, corner = transport.nodes.weight, transport.nodes.corner
        received = jnp.einsum("tk,ntkc->ntc", weight, received[:, corner], precision="highest")
    leaving = transport.receiver_scattering(differentiable=True)
    if leaving is None:
        return received
    shared = transport.receiver_hits is transport.sample_hits
    own = albedo if shared else jnp.asarray(transport.receivers.albedo, albedo.dtype)
    return shown(leaving, own[:, : albedo.shape[1]], received, arriving_light(gather, direct, outgoing))
