"""The fit of `svd-ridge` on light that is read in blocks of receivers: less memory, and less time, for large lightmaps.

Normalising, centring and rotating all act on the columns, so one pass gathers the Gram matrix of the light as it comes and
a second one makes the basis. Values only: fits that are differentiated, and those of light in float64, are in memory.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import zarr
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

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
        """Each block, and which receivers it is of; the next one is read meanwhile."""
        starts = range(0, self.shape[1], self.step)
        with ThreadPoolExecutor(1) as executor:
            coming = executor.submit(self._block, 0)
            for first in starts:
                block = coming.result()
                if first != starts[-1]:
                    coming = executor.submit(self._block, first + self.step)
                yield slice(first, min(first + self.step, self.shape[1])), block

    def _block(self, first: int) -> Float[np.ndarray, "N t C"]:
        return self.read(first, min(first + self.step, self.shape[1]))

    def filled(self, block: Float[np.ndarray, "N t C"]) -> Float[np.ndarray, "N step C"]:
        """A block, the last one filled up with darkness, so that one kernel serves all."""
        short = self.step - block.shape[1]
        return np.pad(block, ((0, 0), (0, short), (0, 0))) if short else block


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
    gram = jnp.zeros((len(measured) * channels,) * 2)
    for _, light in indirect:
        gram = _add_gram(gram, indirect.filled(light))
    require_finite("indirect", gram)
    count, eps = min(basis - mean, receivers, len(gram)), float(jnp.finfo(indirect.dtype).eps)
    found = _rotation(gram, jnp.asarray(measured), receivers, eps, count, mean, normalise)
    rank = int(jnp.sum(found.kept))

    # U = Y · turn · L⁻ᵀ, with the mean before it
    u = np.zeros((receivers, mean + count))
    turned, square = u[:, mean : mean + rank], np.zeros((rank, rank))
    for rows, light in indirect:
        part = np.asarray(_turned(indirect.filled(light), found.turn))[: len(u[rows])]
        u[rows, :mean], turned[rows] = part[:, :mean], part[:, 1 : 1 + rank]
        square += turned[rows].T @ turned[rows]
    lower = scipy.linalg.cholesky(square, lower=True)
    mend = scipy.linalg.solve_triangular(lower, np.eye(rank), lower=True)  # all but the identity
    for first in range(0, receivers, indirect.step):
        rows = slice(first, first + indirect.step)
        turned[rows] = turned[rows] @ mend.T
    coefficients = jnp.zeros_like(found.coefficients).at[:rank].set(mend @ found.coefficients[:rank])
    length = np.linalg.norm(u[:, 0]) if mean else 0.0
    if mean:
        u[:, 0] /= length or 1.0
    weights = _weights(found, coefficients, ridge_factor, length, mean, channels if per_channel else 1)
    return LinearModel(jnp.asarray(u), weights, found.values)


class _Rotation(NamedTuple):
    """What the columns of light Y become: Y · turn is the mean and the components, those that are not `kept` zero."""

    x: Float[Array, "M n"]
    norm: Float[Array, " n"]
    values: Float[Array, " n"]
    kept: Bool[Array, " B"]
    turn: Float[Array, "n B+1"]
    coefficients: Float[Array, "B n"]


@partial(jax.jit, static_argnames=("receivers", "eps", "count", "mean", "normalise"))
def _rotation(
    gram: Float[Array, "n n"], measured: Float[Array, "N M C"], receivers: int, eps: float, count: int, mean: bool,
    normalise: Norm,
) -> _Rotation:  # fmt: skip
    """Normalise, centre and rotate, as `fit_svd_ridge` does with the light itself; eps is that of the light's dtype."""
    x, y_norm = columns(measured), jnp.sqrt(jnp.diagonal(gram))
    scale, norm = (part[0] for part in column_scale(x, y_norm[None], receivers, normalise))
    floor = len(gram) ** 0.5 * eps * safe_norm(y_norm * scale, axis=0)
    change = jnp.diag(scale)
    towards_mean = weighted_mean(change, norm)
    if mean:
        change = change - towards_mean * norm
    squares, v = jnp.linalg.eigh(_product(change.T, _product(gram, change)))
    values = jnp.sqrt(jnp.maximum(squares[::-1], 0.0))
    kept = values[:count] > floor
    turn = _product(change, v[:, ::-1][:, :count] * jnp.where(kept, 1.0 / jnp.where(kept, values[:count], 1.0), 0.0))
    coefficients = _product(turn.T, _product(gram, change))
    return _Rotation(x * scale, norm, values, kept, jnp.concatenate([towards_mean, turn], axis=1), coefficients)


@partial(jax.jit, static_argnames=("mean", "channels"))
def _weights(
    found: _Rotation, coefficients: Float[Array, "B n"], ridge_factor: float, length: float, mean: bool, channels: int
) -> Float[Array, "W b M+1"]:
    """The regression onto the coefficients; with the row of a mean of that length first where there is one."""
    x, norm = found.x, found.norm
    if not mean:
        matrix, _ = regress(x, coefficients, norm, ridge_factor, x, channels)
        return jnp.pad(matrix, ((0, 0), (0, 0), (0, 1)))
    mu_x = weighted_mean(x, norm)
    matrix, offset = regress(x - mu_x * norm, coefficients, norm, ridge_factor, x, channels)
    return mean_weights(matrix, mu_x, jnp.asarray(length), offset)


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
