"""What distant light causes at points, from which of their rays escape: transfer vectors, and Sloan's matrices for small cases.

The directions are those of `hemisphere.py`. Reading hit tables and following bounces is left to `methods/escaping.py`.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from prt_bench.hemisphere import HemisphereSampler
from prt_bench.spherical import bands, cosine_lobe, evaluate, rotate


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
