"""The only home of SVD, ridge, orthonormal bases and norms: stable values and stable gradients.

Everything here works under `jit`, `vmap` and `grad`, is meant for float64, and never forms an inverse. Values and
derivatives are separate matters: derivatives follow implicit rules that divide only by what is bounded away from zero, so
they stay finite and right for repeated singular values, duplicated points, dark lightings and missing rank.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from jaxtyping import Array, Bool, Float

_Factors = tuple[Array, Array, Array]

_GRAM_NOISE = 16.0
"""Squared singular values under this many n · eps · σ₁² are rounding of the Gram matrix."""
_FEW = 6
"""From matrices this many times larger than what is asked for, Lanczos is faster than a full decomposition."""


def safe_norm(x: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """Euclidean norm along `axis`, kept as an axis of length 1, with gradient 0 at 0 and no overflow or underflow."""
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(x), axis=axis, keepdims=True))
    dark = largest == 0
    scale = jnp.where(dark, 1.0, largest)
    squared = jnp.sum((x / scale) ** 2, axis=axis, keepdims=True)
    return jnp.where(dark, 0.0, scale * jnp.sqrt(jnp.where(dark, 1.0, squared)))


def rounding_floor(matrix: Float[Array, "... n"], dtype: jnp.dtype | type = jnp.float64) -> Float[Array, ""]:
    """Singular values up to this are rounding of data that came in `dtype`: √n · eps · ‖matrix‖_F.

    Give the matrix *before* centring: a constant dataset centres to pure rounding, which has no scale of its own.
    """
    return jnp.sqrt(matrix.shape[-1]) * float(jnp.finfo(dtype).eps) * jnp.sqrt(jnp.sum(matrix * matrix))


# --- SVD ---------------------------------------------------------------------------------------------------------------


def _divide_and_conquer(matrix: Array) -> _Factors:
    return tuple(jnp.linalg.svd(matrix, full_matrices=False))


def _transposed(matrix: Array) -> _Factors:
    u, s, vt = jnp.linalg.svd(matrix.T, full_matrices=False)
    return vt.T, s, u.T


def _qr_first(matrix: Array) -> _Factors:
    q, r = jnp.linalg.qr(matrix)
    u, s, vt = jnp.linalg.svd(r, full_matrices=False)
    return _matmul(q, u), s, vt


_ROUTES: tuple[Callable[[Array], _Factors], ...] = (_divide_and_conquer, _transposed, _qr_first)


def svd(matrix: Float[Array, "m n"]) -> tuple[Float[Array, "m k"], Float[Array, " k"], Float[Array, "k n"]]:
    """Thin SVD U, σ, Vᵀ, values only (its derivative does not exist where singular values repeat; see `leading_basis`).

    LAPACK's divide and conquer now and then returns NaN on clean data; the transposed matrix, then its triangular factor,
    are tried in turn. NaN in the input gives NaN.
    """
    matrix = jax.lax.stop_gradient(matrix)
    factors = _ROUTES[0](matrix)
    for route in _ROUTES[1:]:
        factors = jax.lax.cond(_finite(factors), lambda found, _: found, lambda _, m, r=route: r(m), factors, matrix)
    return factors


def _finite(factors: _Factors) -> Bool[Array, ""]:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(factor)) for factor in factors]))


# --- leading left singular vectors -------------------------------------------------------------------------------------


@partial(jax.jit, static_argnames="count")
def leading_basis(
    matrix: Float[Array, "T n"], count: int, floor: Float[Array, ""] | float
) -> tuple[Float[Array, "T B"], Float[Array, " n"]]:
    """The `count` ≥ 1 leading left singular vectors of a tall matrix, and all its singular values, descending.

    Columns beyond the effective rank are zero. Singular values have the absolute error √eps · σ₁, and derivative zero.

    A singular value counts when it exceeds `floor` (see `rounding_floor`). Eigenvectors V of the small Gram matrix, then a
    Householder QR of matrix · V: the QR restores the orthogonality that the Gram matrix loses for small singular values
    (to machine precision, for any conditioning), at a third of the time of an SVD of the tall matrix. Where the cut and the
    floor both lie in the Gram matrix's rounding (never for data that came in float32) V is that of the triangular factor.

    Differentiable as a *subspace*: the rule moves each vector only out of the span, so whatever depends on UUᵀ alone (every
    projection, every fitted prediction) has the right derivative, and only gaps across the cut are divided by. Where there
    is no gap at the cut the subspace itself is arbitrary; pairs without a gap then add nothing to the derivative.
    """
    return _leading_basis(matrix, count, floor)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _leading_basis(matrix: Array, count: int, floor: Array | float) -> tuple[Array, Array]:
    u, _, _, squares = _leading(matrix, count, floor)
    return u, jnp.sqrt(squares)


def _leading(matrix: Array, count: int, floor: Array | float) -> tuple[Array, Array, Array, Array]:
    """U [T, B], the rank mask [B], and all n right singular vectors and squared singular values of the Gram matrix."""
    count = min(count, *matrix.shape)
    squares, v = jnp.linalg.eigh(_matmul(matrix.T, matrix))
    squares, v = jnp.maximum(squares[::-1], 0.0), v[:, ::-1]
    if matrix.shape[0] >= matrix.shape[1]:
        noise = _GRAM_NOISE * matrix.shape[1] * jnp.finfo(matrix.dtype).eps * squares[0]
        cut_in_noise = (squares[count - 1] < noise) & (jnp.square(floor) < noise)
        squares, v = jax.lax.cond(cut_in_noise, _right_factors, lambda _, *found: found, matrix, squares, v)
    q, r = jnp.linalg.qr(_matmul(matrix, v[:, :count]))
    height = jnp.diagonal(r)
    kept = jnp.abs(height) > floor
    return q * jnp.where(kept, jnp.where(height < 0, -1.0, 1.0), 0.0), kept, v, squares


def _right_factors(matrix: Array, squares: Array, v: Array) -> tuple[Array, Array]:
    """σ² and V of a tall matrix from its triangular factor, where nothing is squared; the Gram matrix's if LAPACK fails."""
    _, s, vt = factors = _divide_and_conquer(jnp.linalg.qr(matrix, mode="r"))
    sound = _finite(factors)
    return jnp.where(sound, s * s, squares), jnp.where(sound, vt.T, v)


@_leading_basis.defjvp
def _leading_basis_jvp(count: int, primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    (matrix, floor), (d_matrix, _) = primals, tangents
    u, kept, v, squares = _leading(matrix, count, floor)
    count = u.shape[1]
    top, rest = v[:, :count], v[:, count:]
    inverse = jnp.where(kept, 1.0 / jnp.sqrt(jnp.where(kept, squares[:count], 1.0)), 0.0)

    # duᵢ = (I − UUᵀ) dA vᵢ / σᵢ + Σ_{j beyond the cut} A vⱼ (vⱼᵀ Aᵀ dA vᵢ / σᵢ + vⱼᵀ dAᵀ uᵢ) / (σᵢ² − σⱼ²)
    moved = _matmul(d_matrix, top) * inverse
    outside = moved - _matmul(u, _matmul(u.T, moved))
    gap = squares[None, :count] - squares[count:, None]
    open_gap = (gap > squares.shape[0] * jnp.finfo(matrix.dtype).eps * squares[0]) & kept[None, :]
    coupling = _matmul(rest.T, _matmul(matrix.T, moved) + _matmul(d_matrix.T, u))
    mixing = jnp.where(open_gap, coupling / jnp.where(open_gap, gap, 1.0), 0.0)
    along = _matmul(matrix, _matmul(rest, mixing))
    moved_out = outside + along - _matmul(u, _matmul(u.T, along))
    return (u, jnp.sqrt(squares)), (moved_out, jnp.zeros_like(squares))


def orthonormal(span: Float[Array, "T B"]) -> Float[Array, "T B"]:
    """An orthonormal basis of the columns' span; zero columns stand for what rank is missing."""
    count = span.shape[1]
    return leading_basis(span, count, rounding_floor(span))[0]


def fewer_columns(matrix: Float[Array, "m n"]) -> Float[Array, "m k"]:
    """The lower triangular L of matrix = L Qᵀ, k = min(m, n): the same left singular vectors and values in fewer columns.

    By Householder reflections, so nothing is squared. Differentiable where the rank is full.
    """
    return jnp.linalg.qr(matrix.T, mode="r").T


def principal_rows(matrix: Float[np.ndarray, "n d"], count: int) -> Float[np.ndarray, "k d"]:
    """Up to `count` leading right singular vectors as rows, in NumPy and of the smaller Gram matrix: for many large matrices.

    By Lanczos where few of many are asked for, from a fixed start. Singular values under 1e-7 of the largest are taken for
    rounding and have none. Values only, never differentiated.
    """
    tall = matrix.shape[0] > matrix.shape[1]
    gram = matrix.T @ matrix if tall else matrix @ matrix.T
    size, energy = len(gram), np.trace(gram)
    if energy == 0:
        return np.zeros((0, matrix.shape[1]))
    if _FEW * count < size:
        start = np.random.default_rng(size).normal(size=size)
        squares, vectors = scipy.sparse.linalg.eigsh(gram / energy, count, v0=start)
    else:
        squares, vectors = scipy.linalg.eigh(gram / energy, subset_by_index=(max(size - count, 0), size - 1))
    kept = squares > 1e-14 * squares[-1]
    found = vectors[:, kept][:, ::-1]
    return np.linalg.qr(found if tall else matrix.T @ found)[0].T


def cut_gap(values: Float[Array, " n"], count: int) -> float:
    """Relative gap (σ_B − σ_{B+1}) / σ₁ at the cut; 0 means that which `count` vectors lead is arbitrary. 1 past the end."""
    if count >= values.shape[0] or values[0] == 0:
        return 1.0
    return float((values[count - 1] - values[count]) / values[0])


# --- ridge -------------------------------------------------------------------------------------------------------------


def relative_damping(x: Float[Array, "M n"], ridge: float | Float[Array, ""]) -> Float[Array, ""]:
    """λ = λ̂ ‖X‖²_F / M: unchanged by the unit of light or by repeating the data, and differentiable everywhere."""
    return ridge * jnp.sum(x * x) / x.shape[0]


@jax.jit
def ridge(x: Float[Array, "M n"], targets: Float[Array, "B n"], damping: Float[Array, ""]) -> Float[Array, "B M"]:
    """W = argmin ‖W X − targets‖² + λ ‖W‖², by SVD filter factors σ / (σ² + λ); λ = 0 gives the minimum-norm solution.

    Forward error ~ eps · κ_λ with κ_λ² = (σ₁² + λ) / (σ_min² + λ); normal equations would square that. Differentiable in all
    arguments for λ > 0, by implicit differentiation of the normal equations (never through the singular vectors).
    """
    return _ridge(x, targets, damping)


@jax.custom_jvp
def _ridge(x: Array, targets: Array, damping: Array) -> Array:
    p, qt, filters, _ = _filter_factors(x, damping)
    return _matmul(_matmul(targets, qt.T) * filters, p.T)


def _filter_factors(x: Array, damping: Array) -> tuple[Array, Array, Array, Array]:
    """Thin SVD of x with the factors of X⁺_λ and of (X Xᵀ + λ)⁻¹ on its left singular vectors."""
    p, s, qt = svd(x)
    kept = _above_rounding(s, x.shape)
    damped = s * s + damping
    filters = jnp.where(kept, s / jnp.where(kept, damped, 1.0), 0.0)
    inverse = jnp.where(kept | (damping > 0), 1.0 / jnp.where(damped > 0, damped, 1.0), 0.0)
    return p, qt, filters, inverse


@_ridge.defjvp
def _ridge_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (x, targets, damping), (dx, d_targets, d_damping) = primals, tangents
    p, qt, filters, inverse = _filter_factors(x, damping)
    w = _matmul(_matmul(targets, qt.T) * filters, p.T)

    # d of W (X Xᵀ + λ) = C Xᵀ:  dW = [(dC − W dX) Xᵀ + (C − W X) dXᵀ − W dλ] (X Xᵀ + λ)⁻¹
    through_data = _matmul(_matmul(d_targets - _matmul(w, dx), qt.T) * filters, p.T)
    pull = _matmul(targets - _matmul(w, x), dx.T)
    inside = _matmul(pull - d_damping * w, p)
    dw = through_data + _matmul(inside * inverse, p.T)
    if x.shape[0] > x.shape[1]:  # more unknowns than columns: outside the range of X only λ holds W down
        outside = pull - _matmul(_matmul(pull, p), p.T)
        dw = dw + jnp.where(damping > 0, outside / jnp.where(damping > 0, damping, 1.0), 0.0)
    return w, dw


# --- leave-one-out -----------------------------------------------------------------------------------------------------


@partial(jax.jit, static_argnames="group")
def leave_one_out(
    x: Float[Array, "M n"], targets: Float[Array, "B n"], damping: Float[Array, ""] | float, group: int = 1
) -> Float[Array, "B n"]:
    """targets − W₋ⱼ x in each column j, where W₋ⱼ is `ridge` on all other columns at the same λ > 0; nothing is refitted.

    `group` consecutive columns leave together: the channels of one lighting would tell of each other. With the residual
    map K = λ (XᵀX + λ)⁻¹ of the fit, the answer is (targets · K)ⱼ Kⱼⱼ⁻¹. K is kept in spectral form and scaled to 1 at its
    largest: nothing cancels as λ → 0 while the columns are independent, and λ may be 0 then. Otherwise the error is
    ~ eps / Kⱼⱼ. Differentiable in all arguments by the rule of the inverse. For many λ, `vmap` over `damping` shares the SVD.
    After Allen 1974, "The Relationship between Variable Selection and Data Augmentation and a Method for Prediction".
    """
    return _leave_one_out(x, targets, jnp.asarray(damping, x.dtype), group)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def _leave_one_out(x: Array, targets: Array, damping: Array, group: int) -> Array:
    residual = _ResidualMap.of(x, damping)
    return _solve_blocks(residual.blocks(group), residual.product(targets))


class _ResidualMap(NamedTuple):
    """K = scale · (XᵀX + λ)⁻¹ = Q diag(f) Qᵀ, plus the identity outside of Q; and (X Xᵀ + λ)⁻¹ X."""

    qt: Array
    f: Array
    scale: Array
    filtered: Array

    @classmethod
    def of(cls, x: Array, damping: Array) -> "_ResidualMap":
        p, s, qt = svd(x)
        kept = _above_rounding(s, x.shape)
        damped = jnp.where(kept, s * s + damping, 1.0)
        scale = damping
        if x.shape[0] >= x.shape[1]:  # independent columns: fits miss nothing but what λ holds back, and λ cancels
            scale = jnp.where(jnp.all(kept), damped[-1], damping)
        return cls(qt, jnp.where(kept, scale / damped, 1.0), scale, _matmul(p * jnp.where(kept, s / damped, 0.0), qt))

    def product(self, rows: Array, power: int = 1) -> Array:
        """rows · K^power."""
        inside = _matmul(rows, self.qt.T)
        product = _matmul(inside * self.f**power, self.qt)
        return product if self._whole else product + (rows - _matmul(inside, self.qt))

    def blocks(self, group: int, power: int = 1) -> Array:
        """The diagonal blocks [n / group, group, group] of K^power."""
        q = self.qt.reshape(len(self.qt), -1, group)
        inside = _outer(q * (self.f**power)[:, None, None], q)
        return inside if self._whole else inside + (jnp.eye(group) - _outer(q, q))

    @property
    def _whole(self) -> bool:
        return self.qt.shape[0] == self.qt.shape[1]


@_leave_one_out.defjvp
def _leave_one_out_jvp(group: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    (x, targets, damping), (dx, d_targets, d_damping) = primals, tangents
    residual = _ResidualMap.of(x, damping)
    rows, blocks = residual.product(targets), residual.blocks(group)
    left_out = _solve_blocks(blocks, rows)

    # dK = −K dXᵀ F − Fᵀ dX K − dλ K² / scale with F = (X Xᵀ + λ)⁻¹ X, and E Kⱼⱼ = (C K)ⱼ gives dE Kⱼⱼ = d(C K)ⱼ − E dKⱼⱼ
    moved, rate = residual.product(dx), d_damping / residual.scale
    d_rows = residual.product(d_targets - _matmul(_matmul(targets, residual.filtered.T), dx))
    d_rows = d_rows - _matmul(_matmul(rows, dx.T), residual.filtered) - rate * residual.product(targets, power=2)
    pair = _outer(*(part.reshape(len(part), -1, group) for part in (moved, residual.filtered)))
    d_blocks = -pair - jnp.swapaxes(pair, 1, 2) - rate * residual.blocks(group, power=2)
    carried = jnp.einsum("bjg,jgh->bjh", left_out.reshape(len(left_out), -1, group), d_blocks, precision="highest")
    return left_out, _solve_blocks(blocks, d_rows - carried.reshape(left_out.shape))


def _solve_blocks(blocks: Array, rows: Array) -> Array:
    """rows · blocks⁻¹ for symmetric diagonal blocks [n / group, group, group]."""
    count, group, _ = blocks.shape
    columns = jnp.moveaxis(rows.reshape(-1, count, group), 0, 2)
    return jnp.moveaxis(jnp.linalg.solve(blocks, columns), 2, 0).reshape(rows.shape)


def _outer(a: Array, b: Array) -> Array:
    """Σₘ aₘⱼᵢ bₘⱼₗ as [j, i, l]."""
    return jnp.einsum("mji,mjl->jil", a, b, precision="highest")


def _above_rounding(s: Array, shape: tuple[int, ...]) -> Array:
    """Which singular values of a matrix of that shape are more than its rounding."""
    return s > max(shape) * jnp.finfo(s.dtype).eps * s[0]


def _matmul(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")
