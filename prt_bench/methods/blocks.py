"""The fit of `svd-ridge` on light that is read in blocks of receivers: less memory, and less time, for large lightmaps.

Normalising, centring and rotating all act on the columns, so one pass gathers the Gram matrix of the light as it comes and
a second one makes the basis. Values only: fits that are differentiated, and those of light in float64, are in memory.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import zarr
from jax.core import Tracer
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from prt_bench.dataset import LightingDataset
from prt_bench.linalg import safe_norm
from prt_bench.methods.examples import Norm, column_scale, columns, require_finite, weighted_mean
from prt_bench.methods.linear import mean_weights, regress
from prt_bench.models import LinearModel, Observed

_SHARE = 4
"""A block in float64 takes at most this part of the memory: a few copies of it are alive at once."""


@dataclass(frozen=True)
class Blocks:
    """Light [N, T, C] that is read some receivers at a time: `read(first, last)` gives [N, last − first, C]."""

    read: Callable[[int, int], Float[np.ndarray, "N t C"]]
    shape: tuple[int, int, int]
    dtype: np.dtype
    memory: int
    chunk: int = 1

    @classmethod
    def over(cls, ds: Observed, memory: int) -> "Blocks | None":
        """The indirect light of `ds` in blocks, or None where it is traced, in float64 already, or within `memory` bytes."""
        if isinstance(ds, LightingDataset):
            shape = (len(ds), len(ds.points), ds.measured.shape[2])
            stored = ds.arrays["indirect"]
            read, dtype = ds.indirect_at, np.dtype(stored.dtype)
            chunk = stored.chunks[1] if isinstance(stored, zarr.Array) else 1
        elif isinstance(ds.measured, Tracer) or isinstance(ds.indirect, Tracer):
            return None
        else:
            light = ds.indirect
            shape, dtype, chunk = light.shape, light.dtype, 1
            read = lambda first, last: np.asarray(light[:, first:last])  # noqa: E731
        if dtype == np.float64 or 8 * np.prod(shape) <= memory:
            return None
        return cls(read, shape, dtype, memory, chunk)

    def then(self, change: Callable[[np.ndarray], np.ndarray]) -> "Blocks":
        """The blocks after an elementwise change."""
        return replace(self, read=lambda first, last: change(self.read(first, last)))

    def interleaved(self) -> "Blocks":
        """The channels as parts of one vector, the channel fastest, as `models.interleaved` has them."""
        lightings, receivers, channels = self.shape

        def read(first: int, last: int) -> np.ndarray:
            start = first // channels
            light = self.read(start, -(-last // channels)).reshape(lightings, -1, 1)
            return light[:, first - start * channels : last - start * channels]

        return replace(self, read=read, shape=(lightings, receivers * channels, 1), chunk=self.chunk * channels)

    @property
    def step(self) -> int:
        """Receivers in a block: whole chunks of the store where the memory allows."""
        lightings, receivers, channels = self.shape
        most = max(1, self.memory // (_SHARE * 8 * lightings * channels))
        return min(max(most - most % self.chunk, min(most, self.chunk)), receivers)

    def __iter__(self) -> Iterator[tuple[slice, Float[np.ndarray, "N t C"]]]:
        """Each block, and which receivers it is of."""
        for first in range(0, self.shape[1], self.step):
            rows = slice(first, min(first + self.step, self.shape[1]))
            yield rows, self.read(rows.start, rows.stop)


def fit_by_blocks(
    measured: Float[np.ndarray, "N M C"],
    indirect: Blocks,
    ridge_factor: float,
    basis: int,
    mean: bool = True,
    per_channel: bool = False,
    normalise: Norm = "indirect",
) -> LinearModel:
    """What `fit_svd_ridge` fits, to rounding of the Gram matrix: singular values have the absolute error √(n · eps) · σ₁.

    That is under `rounding_floor` for light in float32. The Gram matrix is of the light as it comes, in float64; its
    eigenvectors give columns that are orthonormal but for eps · (σ₁ / σ_B)², and a Cholesky factor of *their* Gram matrix
    mends that (Yamamoto et al. 2015, "Roundoff error analysis of the CholeskyQR2 algorithm"). Raises `FitError` for light
    that is not finite. Not differentiable.
    """
    receivers, channels = indirect.shape[1:]
    size = len(measured) * channels
    gram = jnp.zeros((size, size))
    for _, light in indirect:
        gram = _add_gram(gram, light)
    require_finite("indirect", gram)
    x = columns(jnp.asarray(measured))
    y_norm = jnp.sqrt(jnp.diagonal(gram))
    scale, norm = (part[0] for part in column_scale(x, y_norm[None], receivers, normalise))
    floor = size**0.5 * float(jnp.finfo(indirect.dtype).eps) * safe_norm(y_norm * scale, axis=0)

    change = jnp.diag(scale)  # what normalising and centring do to the columns: Y · change
    towards_mean = weighted_mean(change, norm)
    if mean:
        change = change - towards_mean * norm
    squares, v = jnp.linalg.eigh(_product(change.T, _product(gram, change)))
    values = jnp.sqrt(jnp.maximum(squares[::-1], 0.0))
    count = min(basis - mean, receivers, size)
    rank = int(jnp.sum(values[:count] > floor))
    turn = _product(change, v[:, ::-1][:, :rank] / values[:rank])

    # U = Y · turn · L⁻ᵀ, with the mean before it
    u = np.zeros((receivers, mean + count))
    inside = slice(int(mean), mean + rank)
    square = jnp.zeros((rank, rank))
    for rows, light in indirect:
        found = _turned(light, jnp.concatenate([towards_mean, turn], axis=1))
        square = _product(found[:, 1:].T, found[:, 1:]) + square
        u[rows, : mean + rank] = found[:, 1 - mean :]
    lower = jnp.linalg.cholesky(square)
    for first in range(0, receivers, indirect.step):
        rows = slice(first, first + indirect.step)
        u[rows, inside] = solve_triangular(lower, u[rows, inside].T, lower=True).T
    coefficients = solve_triangular(lower, _product(turn.T, _product(gram, change)), lower=True)
    coefficients = jnp.pad(coefficients, ((0, count - rank), (0, 0)))
    return _model(u, x * scale, coefficients, norm, values, ridge_factor, mean, channels if per_channel else 1)


def _rows(light: Float[Array, "N t C"]) -> Float[Array, "n t"]:
    return jnp.moveaxis(light.astype(jnp.float64), 2, 1).reshape(-1, light.shape[1])


@partial(jax.jit, donate_argnums=0)
def _add_gram(gram: Float[Array, "n n"], light: Float[Array, "N t C"]) -> Float[Array, "n n"]:
    rows = _rows(light)
    return gram + _product(rows, rows.T)


@jax.jit
def _turned(light: Float[Array, "N t C"], turn: Float[Array, "n B"]) -> Float[Array, "t B"]:
    return _product(_rows(light).T, turn)


def _product(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")


def _model(
    u: np.ndarray, x: Array, coefficients: Array, norm: Array, values: Array,
    ridge_factor: float, mean: bool, channels: int,
) -> LinearModel:  # fmt: skip
    """The regression onto the coefficients; the first column of u is the mean where there is one, of any length."""
    if not mean:
        matrix, _ = regress(x, coefficients, norm, ridge_factor, x, channels)
        weights = jnp.pad(matrix, ((0, 0), (0, 0), (0, 1)))
        return LinearModel(jnp.asarray(u), weights, values)
    mu_x = weighted_mean(x, norm)
    matrix, offset = regress(x - mu_x * norm, coefficients, norm, ridge_factor, x, channels)
    length = np.linalg.norm(u[:, 0])
    u[:, 0] /= length or 1.0
    return LinearModel(jnp.asarray(u), mean_weights(matrix, mu_x, jnp.asarray(length), offset), values)
