"""Leading left singular vectors: orthonormality, projection error, rank, and the derivative of the subspace.

Bases are compared by their projectors and by the error they leave, never entry by entry.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench import linalg
from prt_bench.stability import families
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.routes import F64, Route

_SHAPE = (60, 24)
_COUNT = 12


class Light(NamedTuple):
    """A tall matrix of light as it arrived, and what its noise is relative to."""

    matrix: np.ndarray
    uncentred: np.ndarray


def bases() -> dict[str, Any]:
    """What finds bases: of a matrix, a number of vectors, and the matrix before centring. In float64, as every fit."""

    def leading(matrix: Any, count: int, uncentred: Any) -> tuple[Any, Any]:
        floor = linalg.rounding_floor(uncentred.astype(jnp.float64), matrix.dtype)
        return linalg.leading_basis(matrix.astype(jnp.float64), count, floor)

    return {"leading_basis": leading}


def _light(matrix: np.ndarray, route: Route) -> Light:
    return Light(route.arrive(matrix), route.arrive(matrix))


def _spectra(route: Route) -> Iterator[Member]:
    for condition in (1e2, 1e4) if route.compute is np.float32 else (1e2, 1e6, 1e12):
        for mode in range(1, 6):
            for seed in families.SEEDS:
                rng = np.random.default_rng([seed, mode])
                values = families.spectrum(mode, _SHAPE[1], condition, rng)
                matrix = families.with_spectrum(values, _SHAPE, rng)
                yield Member(f"mode {mode}, condition {condition:.0e}, seed {seed}", _light(matrix, route))
    for name, matrix in (*families.classics(_SHAPE), *families.scaled(route, _SHAPE)):
        light = _light(matrix, route)
        if np.all(np.isfinite(light.matrix)):
            yield Member(name, light)


def _orthonormality(u: np.ndarray) -> float:
    kept = u[:, np.any(u != 0, axis=0)]
    return float(np.abs(kept.T @ kept - np.eye(kept.shape[1])).max(initial=0.0))


@case("B1", "orthonormal and near the best projection", subjects=bases, family=_spectra)
def best_projection(leading: Any, light: Light, route: Route) -> Iterator[Measured]:
    """B1, B6: ‖UᵀU − I‖ ≤ 30 · n · eps; what the basis leaves is at most 1.1 times what the best one would."""
    u = np.asarray(leading(jnp.asarray(light.matrix), _COUNT, jnp.asarray(light.uncentred))[0], np.float64)
    unit = _COUNT * F64.eps
    yield Measured(_orthonormality(u), 30 * unit, unit)
    matrix = light.matrix.astype(np.float64)
    matrix = matrix / np.abs(matrix).max()
    values = np.linalg.svd(matrix, compute_uv=False)
    left = np.linalg.norm(matrix - u @ (u.T @ matrix))
    floor = 30 * np.sqrt(_SHAPE[1]) * route.eps * np.linalg.norm(matrix)
    yield Measured(float(left), float(1.1 * np.linalg.norm(values[_COUNT:]) + floor))


def _deficient(route: Route) -> Iterator[Member]:
    for rank in (1, 4, 8):
        for seed in range(3):
            rng = np.random.default_rng([seed, rank])
            whole = rng.integers(-8, 9, (_SHAPE[0], rank)) @ rng.integers(-3, 4, (rank, _SHAPE[1]))
            yield Member(f"rank {rank}, seed {seed}", (_light(whole / 16, route), np.linalg.matrix_rank(whole)))


@case("B2", "more vectors than rank", subjects=bases, family=_deficient)
def rank(leading: Any, posed: tuple[Light, int], route: Route) -> Iterator[Measured]:
    """B2: as many vectors as there is rank, the rest are zero. Small integers keep their rank in every dtype."""
    light, wanted = posed
    u = np.asarray(leading(jnp.asarray(light.matrix), _COUNT, jnp.asarray(light.uncentred))[0], np.float64)
    yield Measured(abs(int(np.sum(np.any(u != 0, axis=0))) - min(int(wanted), _COUNT)), 0.5)
    yield Measured(_orthonormality(u), 30 * _COUNT * route.eps)


def _constant(route: Route) -> Iterator[Member]:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        light = route.arrive(np.repeat(rng.uniform(0.1, 1.0, (_SHAPE[0], 1)), _SHAPE[1], axis=1))
        centred = light - np.mean(light, axis=1, keepdims=True, dtype=route.compute) * route.compute(1 + 2 * route.eps)
        yield Member(f"seed {seed}", Light(centred, light))


@case("B3", "constant light, centred", subjects=bases, family=_constant)
def constant(leading: Any, light: Light, route: Route) -> Iterator[Measured]:
    """B3: what is left is rounding, and counts for nothing beside the light before centring."""
    u = np.asarray(leading(jnp.asarray(light.matrix), _COUNT, jnp.asarray(light.uncentred))[0])
    yield Measured(float(np.sum(np.any(u != 0, axis=0))), 0.5)


@case(
    "B5", "order of the lightings, symmetric light", subjects=bases,
    family=lambda route: (
        Member(f"seed {seed}", _light(np.kron(np.eye(2), np.random.default_rng(seed).normal(size=(30, 12))), route))
        for seed in range(3)
    ),
)  # fmt: skip
def order(leading: Any, light: Light, route: Route) -> Iterator[Measured]:
    """B5: every singular value twice; the bases differ, their projectors do not."""
    matrix = light.matrix
    shuffled = matrix[:, np.random.default_rng(1).permutation(matrix.shape[1])]
    u, v = (
        np.asarray(leading(jnp.asarray(m), _COUNT, jnp.asarray(light.uncentred))[0], np.float64)
        for m in (matrix, shuffled)
    )
    values = np.linalg.svd(matrix.astype(np.float64), compute_uv=False)
    unit = F64.eps * float(values[0] ** 2 / (values[_COUNT - 1] ** 2 - values[_COUNT] ** 2))
    yield Measured(float(np.abs(u @ u.T - v @ v.T).max()), 30 * unit, unit)


_SPECTRA = {
    "distinct": [3.0, 2.0, 1.5, 1.0, 0.5],
    "repeated above the cut": [2.0, 2.0, 2.0, 1.0, 0.5],
    "repeated below the cut": [3.0, 2.0, 1.5, 0.5, 0.5],
    "rank equal to the cut": [3.0, 2.0, 2.0],
}


def _subspaces(route: Route) -> Iterator[Member]:
    for name, values in _SPECTRA.items():
        for seed in families.SEEDS:
            rng = np.random.default_rng(seed)
            diagonal = np.zeros((9, 6))
            np.fill_diagonal(diagonal, [*values, *[0.0] * (6 - len(values))])
            yield Member(f"{name}, diagonal, seed {seed}", (diagonal, seed))
            yield Member(f"{name}, seed {seed}", (families.with_spectrum(np.array(values), (9, 6), rng), seed))


@case("B4", "projector on repeated singular values", kind=Kind.GRADIENT, subjects=bases, family=_subspaces)
def subspace_gradient(leading: Any, posed: tuple[np.ndarray, int], route: Route) -> Iterator[Measured]:
    """B4: the derivative of an SVD divides by every gap, the projector's only by those across the cut.

    The light moves within its rank, where the subspace is smooth.
    """
    matrix, seed = posed
    rng = np.random.default_rng(seed)
    left, right = (rng.normal(size=(size, size)) / 4 for size in matrix.shape)
    floor = 30 * route.eps * np.linalg.norm(matrix)

    def projector(amount: jax.Array) -> jax.Array:
        moved = (jnp.eye(9) + amount[0] * left) @ route.arrive(matrix) @ (jnp.eye(6) + amount[1] * right)
        u, _ = linalg.leading_basis(moved.astype(jnp.float64), 3, floor)
        return u @ u.T

    return gradient_error(projector, [np.zeros(2)], [np.array([1.0, -0.7])], route)


@case(
    "B4", "no gap at the cut", kind=Kind.REFUSAL, subjects=lambda: {"cut_gap": linalg.cut_gap},
    family=lambda route: (
        Member(f"{values}, cut at {cut}", (route.arrive(np.array(values)), cut))
        for values, cut in (([2.0, 1.0, 1.0], 2), ([1.0] * 5, 3), ([5.0, 0.25, 0.25, 0.0], 2))
    ),
)  # fmt: skip
def gapless(gap: Any, posed: tuple[np.ndarray, int], route: Route) -> bool:
    """B4: which vectors lead is arbitrary there, and the gap says so."""
    return gap(jnp.asarray(posed[0]), posed[1]) < 1e-6
