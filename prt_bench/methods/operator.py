"""The traced operator as the operator methods use it: forward on patterns of direct light, or its adjoint on a basis."""

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset, Transport
from prt_bench.transport import GatherOperator, Scattering, final_gather, irradiance, radiosity, shown

_RECEIVERS = 8192  # rows of the receiver table in memory at once
_COLUMNS = 64  # patterns that are sent through the operator at once
_STREAMED = 512  # streamed lightings in memory at once


def fit_albedo(ds: LightingDataset) -> Float[Array, "S C"]:
    """Albedo of the gather samples, one channel where the light and the scene have no colour."""
    coloured = ds.indirect.shape[2] > 1 and not ds.transport.scene.achromatic
    return jnp.asarray(ds.transport.samples.albedo[:, : 3 if coloured else 1], jnp.float32)


def respond(
    transport: Transport, albedo: Float[Array, "S C"], direct: Float[np.ndarray, "S P"]
) -> Float[np.ndarray, "T C P"]:
    """𝒮 · direct: the indirect light of all bounces that P grey patterns of direct light cause, as receivers show it; float32,
    as the bake."""
    channels = albedo.shape[1]
    traced = transport.traced
    out = np.empty((len(traced.receivers), channels, direct.shape[1]), np.float32)
    gather, within, leaving = transport.sample_gather(), transport.sample_scattering(), transport.receiver_scattering()
    result = out if leaving is None else np.empty((len(transport.receivers), *out.shape[1:]), np.float32)
    for start in range(0, direct.shape[1], _COLUMNS):
        columns = slice(start, start + _COLUMNS)
        part = jnp.asarray(direct[:, columns].T, jnp.float32)[:, :, None]
        light = jnp.broadcast_to(part, (*part.shape[:2], channels))
        outgoing = radiosity(gather, albedo, light, transport.bounces - 1, within)
        for rows in _row_blocks(len(out)):
            received = final_gather(traced.receiver_gather(rows), outgoing)
            out[rows, :, columns] = np.moveaxis(np.asarray(received), 0, 2)
        if leaving is not None:
            gathered = jnp.moveaxis(jnp.asarray(transport.spread(out[:, :, columns])), 2, 0)
            own = jnp.asarray(transport.receivers.albedo[:, :channels], jnp.float32)
            seen = shown(leaving, own, gathered, irradiance(gather, light, outgoing))
            result[:, :, columns] = np.moveaxis(np.asarray(seen), 0, 2)
    return transport.spread(out) if leaving is None else result


def importance(transport: Transport, albedo: Float[Array, "S C"], u: Float[Array, "T B"]) -> Float[Array, "C S B"]:
    """𝒮ᵀ U: what direct light at each sample adds to each coefficient, through all bounces.

    The adjoint carries B columns where the forward operator would carry one for each pattern. Differentiable in u and
    albedo, in the precision of u: derivatives of a fit are held to 1e-6, which float32 within would cost.
    """
    if transport.walks is not None:
        return jnp.stack([_importance_within(transport, albedo, u, channel) for channel in range(albedo.shape[1])])
    received = _received(transport, u)
    gather = transport.sample_gather(differentiable=True)
    return jnp.stack(
        [_transposed_bounces(gather, albedo[:, c : c + 1], received, transport.bounces) for c in range(albedo.shape[1])]
    )


def _importance_within(
    transport: Transport, albedo: Float[Array, "S C"], u: Float[Array, "T B"], channel: int
) -> Float[Array, "S B"]:
    """The same for one channel of a scene with translucent bodies: first the transpose of `shown`, then that of the bounces."""
    within, leaving = (
        part.channel(channel)
        for part in (transport.sample_scattering(None, True), transport.receiver_scattering(slice(None), None, True))
        if part is not None
    )
    gather, own = transport.sample_gather(differentiable=True), jnp.asarray(transport.receivers.albedo, u.dtype)
    rows = leaving.rows
    u = u.at[rows].divide(leaving.colour.astype(u.dtype))
    arriving = _transposed_gather(leaving.walks[0], leaving.shares(u[rows]))
    received = _received(transport, u.at[rows].multiply(own[rows, channel, None])) + _transposed_gather(
        gather, arriving
    )
    return arriving + _transposed_bounces(gather, albedo[:, channel : channel + 1], received, transport.bounces, within)


def _received(transport: Transport, u: Float[Array, "T B"]) -> Float[Array, "S B"]:
    """Gᵀ U: the transpose of the final gather, through nodes where there are any."""
    received = jnp.zeros((len(transport.samples), u.shape[1]), u.dtype)
    traced, nodes = transport.traced, transport.nodes
    if nodes is not None:  # what `spread` does, the other way
        shares = jnp.asarray(nodes.weight, u.dtype)[:, :, None] * u[:, None]
        ends = jnp.asarray(nodes.corner).reshape(-1)
        u = jax.ops.segment_sum(shares.reshape(-1, u.shape[1]), ends, num_segments=len(nodes.points))
    for rows in _row_blocks(u.shape[0]):
        received += _transposed_gather(traced.receiver_gather(rows), u[rows])
    return received


@jax.jit
def coefficients(importance: Float[Array, "C S B"], direct: Float[Array, "S n"]) -> Float[Array, "C B n"]:
    """Coefficients of the indirect light that patterns of direct light cause, from the adjoint `importance`."""
    return jnp.einsum("csb,sn->cbn", importance, direct, precision="highest").astype(jnp.float64)


def streamed_blocks(ds: LightingDataset) -> Iterator[tuple[slice, Float[np.ndarray, "S n"]]]:
    """Direct light of the streamed lightings at the gather samples, some lightings at a time."""
    direct = ds.streamed.direct
    for start in range(0, direct.shape[0], _STREAMED):
        rows = slice(start, min(start + _STREAMED, direct.shape[0]))
        yield rows, np.asarray(direct[rows]).T


def _row_blocks(receivers: int) -> Iterator[slice]:
    return (slice(start, min(start + _RECEIVERS, receivers)) for start in range(0, receivers, _RECEIVERS))


@jax.jit
def _transposed_gather(gather: GatherOperator, u: Float[Array, "P B"]) -> Float[Array, "S B"]:
    _, transposed = jax.vjp(gather, jnp.zeros((gather.samples, u.shape[1]), u.dtype))
    return transposed(u)[0]


@partial(jax.jit, static_argnames="bounces")
def _transposed_bounces(
    gather: GatherOperator,
    albedo: Float[Array, "S 1"],
    received: Float[Array, "S B"],
    bounces: int,
    scattering: Scattering | None = None,
) -> Float[Array, "S B"]:
    def outgoing(direct: Float[Array, "B S 1"]) -> Float[Array, "S B 1"]:
        return radiosity(gather, albedo, direct, bounces - 1, scattering)

    _, transposed = jax.vjp(outgoing, jnp.zeros((received.shape[1], received.shape[0], 1), received.dtype))
    return transposed(received[:, :, None])[0][:, :, 0].T
