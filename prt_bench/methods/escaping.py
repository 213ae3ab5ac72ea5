"""Transfer vectors of distant light: from the rays that escape, and through all bounces by the traced operator."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from prt_bench.dataset import Transport
from prt_bench.errors import FitError
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.methods.operator import respond
from prt_bench.points import SurfacePoints
from prt_bench.spherical import bands, cosine_lobe, evaluate, rotate

_POINTS = 1 << 14  # points whose rays are in memory at once


def transfer_vectors(
    transport: Transport, albedo: Float[Array, "S C"], order: int
) -> tuple[Float[np.ndarray, "T K"], Float[np.ndarray, "T C K"]]:
    """What distant light of each harmonic causes at the receivers: direct, and by all bounces. In steradians, float32.

    The bounces take the same way as any other light: direct transfer at the gather samples goes through the operator, a
    column for each harmonic. Raises `FitError` for a transport that kept no directions of its rays.
    """
    direct = direct_transfer(transport, transport.receiver_hits, transport.receivers, order)
    if transport.receiver_hits is transport.sample_hits:
        at_samples = direct
    else:
        at_samples = direct_transfer(transport, transport.sample_hits, transport.samples, order)
    return direct, respond(transport, albedo, at_samples)


def direct_transfer(transport: Transport, table: Any, points: SurfacePoints, order: int) -> Float[np.ndarray, "P K"]:
    """`escaping_transfer` of all points of a hit table, some of them in memory at a time."""
    if transport.sampler is None:
        raise FitError(f"the transport of '{transport.scene.name}' kept no directions of its rays; bake it again")
    out = np.empty((len(points), order * order), np.float32)
    for at in range(0, len(points), _POINTS):
        rows = slice(at, at + _POINTS)
        escaped = np.asarray(table[rows]) == len(transport.samples) + 1
        out[rows] = escaping_transfer(escaped, transport.sampler, at, points.normal[rows], order)
    return out


def escaping_transfer(
    escaped: Bool[np.ndarray, "P R"],
    sampler: HemisphereSampler,
    first: int,
    normal: Float[np.ndarray, "P 3"],
    order: int,
    rays: slice = slice(None),
) -> Float[np.ndarray, "P K"]:
    """T_k = ∫ V y_k max(n·ω, 0) dω in steradians at the points `first`, `first` + 1, …, given which of their rays `escaped`.

    All points of one set of directions share their harmonics in the local frame, so the sum over rays is one product with
    the bits of visibility; it is turned into the world afterwards. What a set gets wrong about the cosine itself is known
    exactly, and taken out by the share of rays that escape: the vector of an open point has no noise. `escaped` may hold
    some of the `rays` alone, for two estimates to be compared.
    """
    local = np.asarray(sampler.local, np.float64)[:, rays]
    harmonics = np.asarray(evaluate(local, order)) * (np.pi / local.shape[1])
    defect = unoccluded(order) - harmonics.sum(axis=1)
    turns = sampler.turns(first, normal)
    found = np.empty((len(normal), order * order), np.float32)
    for chosen in np.unique(turns.chosen):
        here = turns.chosen == chosen
        visible = escaped[here].astype(np.float32)
        share = visible.mean(axis=1, keepdims=True)
        found[here] = visible @ harmonics[chosen].astype(np.float32) + share * defect[chosen].astype(np.float32)
    return np.asarray(rotate(jnp.asarray(found), jnp.swapaxes(jnp.asarray(turns.frames), 1, 2)))


def transfer_matrices(
    escaped: Bool[np.ndarray, "P R"],
    sampler: HemisphereSampler,
    first: int,
    normal: Float[np.ndarray, "P 3"],
    order: int,
) -> Float[np.ndarray, "P K K"]:
    """∫ V y_i y_j max(n·ω, 0) dω in steradians: what takes light to what arrives and weighs at a point, K² numbers each.

    Sloan et al. 2002 keep this matrix for glossy surfaces. It is exact in what the triple product of vectors cuts off: products
    of light above the order with visibility above it. The size forbids it in textures; this is for small cases.
    """
    harmonics = np.asarray(evaluate(np.asarray(sampler.local, np.float64), order))
    products = np.einsum("sri,srj->srij", harmonics, harmonics).reshape(*harmonics.shape[:2], -1)
    products = (products * (np.pi / products.shape[1])).astype(np.float32)
    turns = sampler.turns(first, normal)
    found = np.empty((len(normal), order**2, order**2), np.float32)
    for chosen in np.unique(turns.chosen):
        here = turns.chosen == chosen
        found[here] = (escaped[here].astype(np.float32) @ products[chosen]).reshape(-1, order**2, order**2)
    to_world = jnp.swapaxes(jnp.asarray(turns.frames), 1, 2)
    once = rotate(jnp.asarray(found), to_world)  # rows, then columns
    return np.asarray(jnp.swapaxes(rotate(jnp.swapaxes(once, 1, 2), to_world), 1, 2))


def unoccluded(order: int) -> Float[np.ndarray, " K"]:
    """∫ y_k max(z, 0) dω: the transfer of an open point that faces z."""
    return np.asarray(cosine_lobe(order))[bands(order)] * np.asarray(evaluate(np.array([0.0, 0.0, 1.0]), order))
