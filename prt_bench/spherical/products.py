"""Products of functions: the tensor Γ_ijk = ∫ y_i y_j y_k dω, exact and sparse, and what it multiplies.

The product of two functions of order L has order 2L − 1; what is computed here is its part below L. It is a projection, so it
is commutative but not associative.
"""

from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.errors import SpecError
from prt_bench.spherical.harmonics import Real, as_floating, azimuths, bands, count, evaluate, order_of, quadrature


class TripleProducts(NamedTuple):
    """The entries of Γ that are not zero: indices (i, j, k) sorted, and values in float64. Every permutation is listed."""

    indices: Int[np.ndarray, "n 3"]
    values: Float[np.ndarray, " n"]


@cache
def triple_products(order: int) -> TripleProducts:
    """Γ by quadrature of degree 3 (order − 1), which is exact; sorted indices are integrated, permutations copied.

    Selection rules leave out what vanishes: bands must form a triangle of even sum, ± m must add up to zero, and an even
    number of sines must meet. At order 5 there are 1158 entries of 15 625.
    """
    i, j, k = _candidates(order).T
    directions, weight = quadrature(3 * (order - 1))
    harmonics = np.asarray(evaluate(directions, order)).T
    pairs, at = np.unique(i * order**2 + j, return_inverse=True)
    products = harmonics[pairs // order**2] * harmonics[pairs % order**2] * weight
    values = np.empty(len(i))
    for start in range(0, len(i), _GROUP):
        part = slice(start, start + _GROUP)
        values[part] = np.einsum("nq,nq->n", products[at[part]], harmonics[k[part]])
    kept = np.abs(values) > _ZERO
    triples = np.stack([i, j, k], axis=1)[kept]
    every = np.concatenate([triples[:, turn] for turn in _PERMUTATIONS])
    indices, first = np.unique(every, axis=0, return_index=True)
    return TripleProducts(indices, np.tile(values[kept], len(_PERMUTATIONS))[first])


_PERMUTATIONS = ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0])
_GROUP = 1 << 14
_ZERO = 1e-10
"""Integrals below this are rounding: the smallest that is not is 7e-4 at order 10."""


def _candidates(order: int) -> Int[np.ndarray, "n 3"]:
    """Indices i ≤ j ≤ k that no selection rule excludes."""
    size = count(order)
    i, j = np.triu_indices(size)
    i, j, k = (part.ravel() for part in np.broadcast_arrays(i[:, None], j[:, None], np.arange(size)))
    i, j, k = (part[(j <= k)] for part in (i, j, k))
    band, m = bands(order), azimuths(order)
    a, b, c = (np.abs(m[part]) for part in (i, j, k))
    allowed = (band[k] <= band[i] + band[j]) & ((band[i] + band[j] + band[k]) % 2 == 0)
    allowed &= (a + b == c) | (b + c == a) | (c + a == b)
    allowed &= ((m[i] < 0).astype(int) + (m[j] < 0) + (m[k] < 0)) % 2 == 0
    return np.stack([i, j, k], axis=1)[allowed]


def product(a: Real, b: Real) -> Float[Array, "... K"]:
    """Coefficients [..., K] of the product of two functions, cut at their order. Leading axes broadcast. Differentiable."""
    a, b = as_floating(a), as_floating(b)
    order = order_of(a.shape[-1])
    if b.shape[-1] != a.shape[-1]:
        raise SpecError(f"functions of {a.shape[-1]} and {b.shape[-1]} coefficients; give both the same order")
    (i, j, k), values = triple_products(order).indices.T, triple_products(order).values
    terms = a[..., i] * b[..., j]
    terms = jnp.moveaxis(terms * jnp.asarray(values, terms.dtype), -1, 0)
    return jnp.moveaxis(jnp.zeros((order**2, *terms.shape[1:]), terms.dtype).at[k].add(terms), 0, -1)


def product_matrix(light: Real) -> Float[Array, "... K K"]:
    """M_ik = Σ_j Γ_ijk L_j of a function [..., K]: symmetric; M f is the product of L and f. Differentiable."""
    light = as_floating(light)
    order = order_of(light.shape[-1])
    (i, j, k), values = triple_products(order).indices.T, triple_products(order).values
    terms = jnp.moveaxis(light[..., j] * jnp.asarray(values, light.dtype), -1, 0)
    flat = jnp.zeros((order**4, *terms.shape[1:]), light.dtype).at[i * order**2 + k].add(terms)
    return jnp.moveaxis(flat, 0, -1).reshape(*light.shape[:-1], order**2, order**2)


def dense_operations(order: int) -> int:
    """Terms Γ_ijk a_i b_j (two multiplications and an addition each) of a product with the whole tensor: K³."""
    return count(order) ** 3


def sparse_operations(order: int) -> int:
    """Terms of a product with the sparse tensor, as `product` adds them up: its number of entries."""
    return len(triple_products(order).values)
