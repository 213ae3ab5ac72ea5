"""Rotation of spherical-harmonic coefficients: one orthogonal block per band, a polynomial in the entries of the matrix.

The recursion of J. Ivanic and K. Ruedenberg, "Rotation Matrices for Real Spherical Harmonics. Direct Determination by
Recursion", J. Phys. Chem. 100 (1996), with the correction of 102 (1998): no angles, so no gimbal, and derivatives everywhere.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.errors import SpecError
from prt_bench.spherical.harmonics import as_floating, count, order_of

Blocks = tuple[Float[Array, "... n n"], ...]
"""D⁰ [..., 1, 1], D¹ [..., 3, 3], D² [..., 5, 5], … of one or many rotations."""
_GROUP = 1 << 13
"""Rotations at a time in `rotate`: their blocks stay in the cache."""


@partial(jax.jit, static_argnames="order")
def rotation_blocks(rotation: Float[Array, "... 3 3"] | Float[np.ndarray, "... 3 3"], order: int) -> Blocks:
    """The blocks D of R with y(R ω) = D y(ω): those that turn a function along with R, f′(ω) = f(Rᵀ ω).

    Any R of O(3), reflections too; R is not made orthogonal. Entry (i, j) belongs to m = i − l, j − l. Differentiable.
    A frame of rows (tangent, bitangent, normal) takes world to local, so its transpose brings local coefficients to the world.
    Rounding: 1e-14 in float64 at order 10, some 1e-6 in float32 at order 20.
    """
    count(order)
    rotation = as_floating(rotation)
    if rotation.shape[-2:] != (3, 3):
        raise SpecError(f"rotations have shape {rotation.shape}, but must end in (3, 3)")
    first = rotation[..., (1, 2, 0), :][..., (1, 2, 0)]  # bands hold y, z, x
    blocks = [jnp.ones((*rotation.shape[:-2], 1, 1), rotation.dtype), first]
    for band in range(2, order):
        blocks.append(_next(first, blocks[-1], band))
    return tuple(blocks[:order])


def _next(first: Array, block: Array, band: int) -> Array:
    """D^l of D¹ and D^(l − 1): the products P_i [2l − 1, 2l + 1] of rows i = y, z, x of D¹, joined by constant matrices."""
    left, right = block[..., :1], block[..., -1:]
    products = []
    for row in range(3):
        y, z, x = (first[..., row, column, None, None] for column in range(3))
        products.append(jnp.concatenate([x * left + y * right, z * block, x * right - y * left], axis=-1))
    joined = jnp.concatenate(products, axis=-2)
    rows, columns = (table.astype(block.dtype) for table in _constants(band))
    return jnp.einsum("ij,...jk->...ik", rows, joined, precision="highest") * columns


@cache
def _constants(band: int) -> tuple[Float[np.ndarray, "rows products"], Float[np.ndarray, " columns"]]:
    """What joins the products P_y, P_z, P_x into rows, and the divisor of every column."""
    most = band - 1
    rows = np.zeros((2 * band + 1, 3, 2 * band - 1))
    for m in range(-band, band + 1):
        row, size, side = rows[m + band], abs(m), -1 if m < 0 else 1
        u = np.sqrt((band + m) * (band - m))
        v = 0.5 * np.sqrt((band + size - 1) * (band + size))
        w = -0.5 * np.sqrt(max(band - size - 1, 0) * (band - size))
        if u:
            row[1, m + most] += u
        if m == 0:
            row[2, 1 + most] -= np.sqrt(2.0) * v
            row[0, -1 + most] -= np.sqrt(2.0) * v
        else:
            inner, outer = side * (size - 1), side * (size + 1)
            near = np.sqrt(2.0) if size == 1 else 1.0
            if m > 0 or size > 1:
                row[2, inner + most] += v * (near if m > 0 else 1.0)
            if m < 0 or size > 1:
                row[0, -inner + most] -= side * v * (near if m < 0 else 1.0)
            if w:
                row[2, outer + most] += w
                row[0, -outer + most] += side * w
    n = np.arange(-band, band + 1)
    divisor = np.where(np.abs(n) < band, (band + n) * (band - n), 2 * band * (2 * band - 1))
    return rows.reshape(2 * band + 1, -1), 1.0 / np.sqrt(divisor)


@jax.jit
def block_diagonal(blocks: Blocks) -> Float[Array, "... K K"]:
    """The blocks as one matrix."""
    size, around = len(blocks) ** 2, [(0, 0)] * (blocks[0].ndim - 2)
    rows = []
    for band, block in enumerate(blocks):
        sides = (band * band, size - (band + 1) ** 2)
        rows.append(jnp.pad(block, [*around, (0, 0), sides]))
    return jnp.concatenate(rows, axis=-2)


def apply(blocks: Blocks, coefficients: Float[Array, "..."]) -> Float[Array, "..."]:
    """Rotated coefficients; leading axes as those of the blocks, any axes behind K. Raises `SpecError` where K differs."""
    axis = blocks[0].ndim - 2
    if coefficients.ndim <= axis or coefficients.shape[axis] != len(blocks) ** 2:
        raise SpecError(
            f"coefficients have shape {coefficients.shape}, but axis {axis} must hold {len(blocks) ** 2} as the blocks do"
        )
    flat = coefficients.reshape(*coefficients.shape[: axis + 1], -1)
    turned = [
        jnp.einsum("...ij,...jc->...ic", block, flat[..., band * band : (band + 1) ** 2, :], precision="highest")
        for band, block in enumerate(blocks)
    ]
    return jnp.concatenate(turned, axis=-2).reshape(coefficients.shape)


@jax.jit
def rotate(
    coefficients: Float[Array, "P K ..."] | Float[np.ndarray, "P K ..."],
    rotation: Float[Array, "P 3 3"] | Float[np.ndarray, "P 3 3"],
) -> Float[Array, "P K ..."]:
    """Each of P coefficient vectors turned by its own rotation, without keeping P blocks; one [3, 3] turns one [K, *C].

    See `rotation_blocks`. Differentiable in both.
    """
    coefficients, rotation = as_floating(coefficients), as_floating(rotation)
    if rotation.ndim == 2:
        return apply(rotation_blocks(rotation, order_of(coefficients.shape[0])), coefficients)
    order = order_of(coefficients.shape[1])

    def one(pair: tuple[Array, Array]) -> Array:
        return apply(rotation_blocks(pair[1], order), pair[0])

    return jax.lax.map(one, (coefficients, rotation), batch_size=_GROUP)
