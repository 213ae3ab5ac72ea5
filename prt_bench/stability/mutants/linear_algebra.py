"""Naive linear algebra: what the printed formulas become when they are typed in."""

from typing import Any

import jax
import jax.numpy as jnp

from prt_bench import linalg
from prt_bench.stability.mutants import mutant

_RIDGE = "prt_bench.linalg:_ridge"
_BASIS = "prt_bench.linalg:_leading_basis"
_VALUES = ("ridge of", "coincident", "NIST", "norm of the matrix")


def _gram(x: Any, damping: Any) -> Any:
    return x @ x.T + damping * jnp.eye(len(x), dtype=x.dtype)


@mutant("normal equations by inverse", _RIDGE, *_VALUES)
def by_inverse(_: Any) -> Any:
    """Squares the condition."""
    return lambda x, targets, damping: targets @ x.T @ jnp.linalg.inv(_gram(x, damping))


@mutant("normal equations by Cholesky", _RIDGE, *_VALUES)
def by_cholesky(_: Any) -> Any:
    """Squares the condition, and breaks down."""
    return lambda x, targets, damping: (
        jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(_gram(x, damping)), True), x @ targets.T).T
    )


@mutant("pseudo-inverse of the Gram matrix", _RIDGE, *_VALUES)
def by_pseudo_inverse(_: Any) -> Any:
    """Its cut-off is the square of the right one."""
    return lambda x, targets, damping: targets @ x.T @ jnp.linalg.pinv(_gram(x, damping))


@mutant("the printed ridge, transposes mixed", _RIDGE, "ridge of scaled", "coincident")
def printed(_: Any) -> Any:
    """Type-checks for as many points as lightings alone."""
    return lambda x, targets, damping: targets @ x @ jnp.linalg.inv(_gram(x.T, damping))


@mutant("no cut-off at zero ridge", _RIDGE, "coincident")
def without_cut_off(_: Any) -> Any:
    """Divides by the rounding of zero."""

    def naive(x: Any, targets: Any, damping: Any) -> Any:
        p, s, qt = linalg.svd(x)
        return (targets @ qt.T * (s / (s * s + damping))) @ p.T

    return naive


@mutant("least squares on the augmented system", _RIDGE, "ridge in light")
def by_lstsq(_: Any) -> Any:
    """Right values; derivatives through an SVD."""

    def naive(x: Any, targets: Any, damping: Any) -> Any:
        tall = jnp.concatenate([x.T, jnp.sqrt(damping) * jnp.eye(len(x), dtype=x.dtype)])
        right = jnp.concatenate([targets.T, jnp.zeros((len(x), len(targets)), x.dtype)])
        return jnp.linalg.lstsq(tall, right)[0].T

    return naive


@mutant("ridge differentiated through the SVD", _RIDGE, "ridge in light")
def through_svd(_: Any) -> Any:
    """Divides by the gaps of equal singular values."""

    def naive(x: Any, targets: Any, damping: Any) -> Any:
        p, s, qt = jnp.linalg.svd(x, full_matrices=False)
        return (targets @ qt.T * (s / (s * s + damping))) @ p.T

    return naive


@mutant("ridge differentiated with the factors held fixed", _RIDGE, "ridge in light")
def factors_fixed(_: Any) -> Any:
    """Forgets that the data are in the factors too."""

    def naive(x: Any, targets: Any, damping: Any) -> Any:
        p, s, qt = linalg.svd(x)
        return (targets @ qt.T * (s / (s * s + damping))) @ p.T

    return naive


@mutant("ridge computed in float32", _RIDGE, "ridge of conditioned")
def ridge_in_float32(sound: Any) -> Any:
    """Loses what float64 was for."""

    def naive(x: Any, targets: Any, damping: Any) -> Any:
        single = (part.astype(jnp.float32) for part in (x, targets, jnp.asarray(damping)))
        return sound(*single).astype(x.dtype)

    return naive


@mutant("products in reduced precision", "prt_bench.linalg:_matmul", "ridge of conditioned", "orthonormal")
def reduced_precision(sound: Any) -> Any:
    """Ten bits of mantissa, as TF32 has."""

    def rounded(a: Any) -> Any:
        mantissa, exponent = jnp.frexp(a)
        return jnp.ldexp(jnp.round(mantissa * 2**11) / 2**11, exponent)

    return lambda a, b: sound(rounded(a), rounded(b))


@mutant("absolute ridge", "prt_bench.linalg:relative_damping", "unit of light and repetition")
def absolute(_: Any) -> Any:
    """Means another thing in other units."""
    return lambda x, ridge: jnp.asarray(ridge, x.dtype)


@mutant("ridge per lighting", "prt_bench.linalg:relative_damping", "unit of light and repetition")
def per_lighting(_: Any) -> Any:
    """Means another thing for the same data twice over."""
    return lambda x, ridge: ridge * jnp.sum(x * x) / x.size


@mutant("norm with NaN gradient at zero", "prt_bench.linalg:safe_norm", "norm of light")
def plain_norm(_: Any) -> Any:
    """The derivative of a square root at zero."""
    return lambda x, axis: jnp.linalg.norm(x, axis=axis, keepdims=True)


@mutant("norm of unscaled squares", "prt_bench.linalg:safe_norm", "norm of light")
def unscaled_norm(_: Any) -> Any:
    """Squares overflow and underflow."""

    def naive(x: Any, axis: int) -> Any:
        squared = jnp.sum(x * x, axis=axis, keepdims=True)
        return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)

    return naive


@mutant("basis from the Gram matrix without QR", _BASIS, "orthonormal", "more vectors")
def gram_alone(_: Any) -> Any:
    """Loses orthogonality with the square of the condition."""

    def naive(matrix: Any, count: int, floor: Any) -> Any:
        squares, v = jnp.linalg.eigh(matrix.T @ matrix)
        s = jnp.sqrt(squares[::-1])
        return (matrix @ v[:, ::-1] / s)[:, :count], s

    return naive


@mutant("basis without a rank floor", _BASIS, "more vectors", "constant light")
def floorless(sound: Any) -> Any:
    """Rounding counts as light."""
    return lambda matrix, count, floor: sound(matrix, count, 0.0)


@mutant("rank floor of the centred light", "prt_bench.linalg:rounding_floor", "constant light")
def centred_floor(_: Any) -> Any:
    """What is left of constant light has no scale of its own."""
    return lambda matrix, dtype=None: jnp.finfo(matrix.dtype).tiny


@mutant("basis differentiated through the SVD", _BASIS, "projector on repeated")
def basis_through_svd(_: Any) -> Any:
    """Divides by every gap."""

    def naive(matrix: Any, count: int, floor: Any) -> Any:
        u, s, _ = jnp.linalg.svd(matrix, full_matrices=False)
        return u[:, :count], s

    return naive


@mutant("basis held fixed in derivatives", _BASIS, "projector on repeated")
def basis_fixed(sound: Any) -> Any:
    """The subspace moves with the light."""
    return lambda matrix, count, floor: sound(jax.lax.stop_gradient(matrix), count, floor)


@mutant("one LAPACK driver", "prt_bench.linalg:svd", "SVD with failing")
def one_driver(_: Any) -> Any:
    """NaN on clean data, now and then."""
    return lambda matrix: linalg._ROUTES[0](matrix)


@mutant("gaps unseen", "prt_bench.linalg:cut_gap", "no gap at the cut")
def blind_to_gaps(_: Any) -> Any:
    """An arbitrary basis goes out without a word."""
    return lambda values, count: 1.0


@mutant("leave-one-out as r / (1 − h)", "prt_bench.linalg:_leave_one_out", "leave-one-out against")
def textbook(_: Any) -> Any:
    """A quotient of roundings at a small ridge."""

    def naive(x: Any, targets: Any, damping: Any, group: int) -> Any:
        weights = jnp.linalg.solve(_gram(x, damping), x)
        return (targets - targets @ x.T @ weights) / (1.0 - jnp.sum(x * weights, axis=0))

    return naive


@mutant("leave-one-out with the factors held fixed", "prt_bench.linalg:_leave_one_out", "leave-one-out in")
def left_out_fixed(_: Any) -> Any:
    """Forgets that the light is in the factors."""

    def naive(x: Any, targets: Any, damping: Any, group: int) -> Any:
        residual = linalg._ResidualMap.of(x, damping)
        return linalg._solve_blocks(residual.blocks(group), residual.product(targets))

    return naive
