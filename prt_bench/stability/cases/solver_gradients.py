"""Derivatives of the ridge, of leave-one-out residuals and of norms, on data that break the derivative of an SVD."""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench import linalg
from prt_bench.stability import exact, families
from prt_bench.stability.cases.linear_solver import Problem, problem, ridge_solvers
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.routes import Route

_SHAPES = ((8, 12), (12, 8))
_FACTOR = 0.05


def degenerate(shape: tuple[int, int], seed: int) -> dict[str, np.ndarray]:
    """Symmetric, duplicated, dark and rank-deficient light of one shape, by name."""
    rng = np.random.default_rng(seed)
    plain = rng.normal(size=shape)
    half = rng.normal(size=(shape[0] // 2, shape[1] // 2))
    row, column = np.arange(shape[0])[:, None], np.arange(shape[1])
    return {
        "plain": plain,
        "symmetric": np.kron(np.eye(2), half),
        "duplicate point": np.where(row == 1, plain[:1], plain),
        "duplicate lighting": np.where(column == 1, plain[:, :1], plain),
        "dark point": plain * (row != 2),
        "dark lighting": plain * (column != 2),
        "rank 2": plain[:, :2] @ rng.normal(size=(2, shape[1])),
        "equal singular values": families.with_spectrum(np.ones(min(shape)), shape, rng),
    }


def _problems(route: Route) -> Iterator[Member]:
    for shape in _SHAPES:
        for seed in families.SEEDS:
            for name, matrix in degenerate(shape, seed).items():
                rng = np.random.default_rng([seed, 5])
                targets = rng.normal(size=(2, shape[1])).astype(route.compute)
                posed = Problem(route.arrive(matrix), targets, _FACTOR)
                yield Member(f"{name}, {shape[0]} × {shape[1]}, seed {seed}", posed)


def _directions(posed: Problem) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.normal(size=posed.x.shape), rng.normal(size=posed.targets.shape), np.asarray(_FACTOR)]


@case(
    "H1", "ridge in light, targets and λ", kind=Kind.GRADIENT, subjects=ridge_solvers, family=_problems,
)  # fmt: skip
def ridge_gradient(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """H1: through the singular vectors it is NaN or wrong by several percent."""

    def fitted(x: jax.Array, targets: jax.Array, factor: jax.Array) -> jax.Array:
        return solver(x, targets, linalg.relative_damping(x, factor))

    arguments = (posed.x, posed.targets, np.asarray(posed.factor))
    return gradient_error(fitted, arguments, _directions(posed), route)


def left_out() -> dict[str, Any]:
    """What leaves lightings out in closed form."""
    return {"leave_one_out": lambda x, targets, damping: linalg.leave_one_out(x, targets, damping)}


@case("A12", "leave-one-out in light, targets and λ", kind=Kind.GRADIENT, subjects=left_out, family=_problems)
def left_out_gradient(leaving: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A12: the residuals choose the ridge, so they must be differentiable wherever the ridge is."""

    def residuals(x: jax.Array, targets: jax.Array, factor: jax.Array) -> jax.Array:
        return leaving(x, targets, linalg.relative_damping(x, factor))

    arguments = (posed.x, posed.targets, np.asarray(posed.factor))
    return gradient_error(residuals, arguments, _directions(posed), route)


def _small_ridges(route: Route) -> Iterator[Member]:
    rng = np.random.default_rng(0)
    for factor in (1e-2, 1e-6) if route.compute is np.float32 else (1e-2, 1e-6, 1e-10, 1e-14):
        for seed in families.SEEDS:
            matrix = np.random.default_rng([seed, 1]).normal(size=families.TALL)
            posed = problem(matrix, factor, route, seed)
            noisy = (posed.targets + rng.normal(size=posed.targets.shape)).astype(route.compute)
            yield Member(f"ridge {factor:g}, seed {seed}", posed._replace(targets=noisy))


@case("A12", "leave-one-out against refitting", subjects=left_out, family=_small_ridges)
def left_out_error(leaving: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A12: r / (1 − h) is a quotient of roundings at a small ridge; K = λ (XᵀX + λ)⁻¹ in spectral form is not."""
    damping = route.compute(posed.damping)
    found = np.asarray(leaving(posed.x, posed.targets, jnp.asarray(damping)), np.float64)
    wanted = exact.leave_one_out(posed.x, posed.targets, float(damping))
    unit = route.eps * posed.kappa**2  # the condition of the Gram matrix, whose inverse the residuals are
    yield Measured(float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted)), 30 * unit, unit)


def _norm_inputs(route: Route) -> Iterator[Member]:
    root = 10.0 ** int(np.log10(float(jnp.finfo(route.data).max)) * 0.6)  # its square is beyond the dtype
    for name, vector in {
        "zero": np.zeros(3), "3, 4, 0": np.array([3.0, 4.0, 0.0]), "tiny": np.array([3.0, -4.0, 12.0]) / root,
        "huge": np.array([3.0, -4.0, 12.0]) * root, "wide": np.array([1.0, 1e-3, 0.0]),
    }.items():  # fmt: skip
        yield Member(name, route.arrive(vector))


@case("C5", "norm of light", subjects=lambda: {"safe_norm": linalg.safe_norm}, family=_norm_inputs)
def norm_value(norm: Any, vector: np.ndarray, route: Route) -> Iterator[Measured]:
    """C5, A7: no overflow and no underflow of squares."""
    found = float(norm(jnp.asarray(vector), axis=0)[0])
    wanted = float(np.linalg.norm(vector.astype(np.longdouble)))
    yield Measured(abs(found - wanted), 4 * route.eps * wanted, route.eps * wanted or None)


@case("C5", "norm of light", kind=Kind.GRADIENT, subjects=lambda: {"safe_norm": linalg.safe_norm}, family=_norm_inputs)
def norm_gradient(norm: Any, vector: np.ndarray, route: Route) -> Iterator[Measured]:
    """C5: x / ‖x‖, and zero in the dark, where the naive norm has NaN."""
    slope = np.asarray(jax.grad(lambda x: norm(x, axis=0)[0])(jnp.asarray(vector)), np.float64)
    size = np.linalg.norm(vector.astype(np.longdouble))
    wanted = (vector / size if size else 0.0 * vector).astype(np.float64)
    yield Measured(float(np.linalg.norm(slope - wanted)), 8 * route.eps)
