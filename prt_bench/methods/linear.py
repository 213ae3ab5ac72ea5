"""What the linear methods share: regression onto coefficients, and how basis, matrix and mean make a `LinearModel`."""

import warnings

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from prt_bench.linalg import cut_gap, relative_damping, ridge, safe_norm
from prt_bench.methods.examples import weighted_mean
from prt_bench.models import LinearModel

_ONE_COLOUR = 1e-5
"""Second singular value of the lightings' colours, relative to the first, up to which they are one."""


def regress(
    x: Float[Array, "M n"],
    coefficients: Float[Array, "B n"],
    norm: Float[Array, " n"],
    ridge_factor: float | Float[Array, ""],
    uncentred: Float[Array, "M n"],
    channels: int = 1,
) -> tuple[Float[Array, "W B M"], Float[Array, "W B 1"]]:
    """Ridge regression u = W x + ‖x‖ κ from measured light to coefficients: one (W, κ), or one for every channel.

    The ridge is relative to `uncentred`, the light before a mean was taken from it: centring leaves the errors of light what
    they were, and of constant light it leaves nothing else. κ is zero but for channels of centred light, each of which has
    a mean of its own beside the joint one.
    """
    matrices, offsets = [], []
    for c in range(channels):
        light, targets, size = x[:, c::channels], coefficients[:, c::channels], norm[c::channels]
        damping = relative_damping(uncentred[:, c::channels], ridge_factor)
        if channels == 1 or uncentred is x:
            matrices.append(ridge(light, targets, damping))
            offsets.append(jnp.zeros((len(targets), 1)))
        else:
            mu_x, mu_u = weighted_mean(light, size), weighted_mean(targets, size)
            matrices.append(ridge(light - mu_x * size, targets - mu_u * size, damping))
            offsets.append(mu_u - jnp.matmul(matrices[-1], mu_x, precision="highest"))
    return jnp.stack(matrices), jnp.stack(offsets)


def linear_model(
    u: Float[Array, "T b"],
    matrix: Float[Array, "W b M"],
    centre: tuple[Float[Array, "M 1"], Float[Array, "T 1"]] | None = None,
    singular_values: Float[Array, " n"] | None = None,
    offset: Float[Array, "W b 1"] | float = 0.0,
) -> LinearModel:
    """y = U W x; with a centre (μ_x, μ_y) of the normalised light, y = ‖x‖ μ_y + U (W (x − ‖x‖ μ_x) + ‖x‖ κ), κ the offset.

    The mean becomes the first basis function, of unit length.
    """
    if centre is None:
        return LinearModel(u, jnp.pad(matrix, ((0, 0), (0, 0), (0, 1))), singular_values)
    mu_x, mu_y = centre
    length = safe_norm(mu_y, axis=0)
    basis = jnp.concatenate([mu_y / jnp.where(length > 0, length, 1.0), u], axis=1)
    return LinearModel(basis, mean_weights(matrix, mu_x, length[0, 0], offset), singular_values)


def mean_weights(
    matrix: Float[Array, "W b M"],
    mu_x: Float[Array, "M 1"],
    length: Float[Array, ""],
    offset: Float[Array, "W b 1"] | float = 0.0,
) -> Float[Array, "W b+1 M+1"]:
    """The weights of a `LinearModel` whose first function is the mean: ‖x‖ · length, then W (x − ‖x‖ μ_x) + ‖x‖ κ."""
    channels, _, measurements = matrix.shape
    mean_row = jnp.zeros((channels, 1, measurements + 1)).at[:, 0, -1].set(length)
    others = jnp.concatenate([matrix, offset - jnp.matmul(matrix, mu_x, precision="highest")], axis=2)
    return jnp.concatenate([mean_row, others], axis=1)


def warn_of_rank(label: str, model: LinearModel) -> None:
    """Warn when the data hold fewer directions than were asked for, or when the cut goes through equal singular values."""
    if model.singular_values is None or isinstance(model.basis, Tracer):
        return
    empty = int(np.sum(~np.any(np.asarray(model.basis), axis=0)))
    size = model.basis.shape[1]
    if empty:
        warnings.warn(
            f"{label}: the training light has rank {size - empty}; {empty} basis functions are zero", stacklevel=3
        )
    elif cut_gap(model.singular_values, size) < 1e-12:
        warnings.warn(
            f"{label}: singular values {size} and {size + 1} are equal, so the basis is arbitrary", stacklevel=3
        )


def warn_of_one_colour(label: str, measured: Float[Array, "N M C"]) -> None:
    """Warn when all training light has one colour: a model that couples channels then knows of no other."""
    if isinstance(measured, Tracer):
        return
    values = np.linalg.svd(np.asarray(jnp.sum(measured, axis=1)), compute_uv=False)
    if values[1] <= _ONE_COLOUR * values[0]:
        warnings.warn(
            f"{label}: all training light has one colour, and coupled channels predict no other;"
            " train under coloured lights, or use transfer = 'shared'",
            stacklevel=3,
        )
