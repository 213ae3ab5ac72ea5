"""Ridge regression and the SVD under it: forward errors against extended precision, certified regressions, exact invariants.

Matrices come from `families`; a solution may be wrong by 30 · eps · κ_λ with κ_λ² = (σ₁² + λ) / (σ_min² + λ).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench import linalg
from prt_bench.stability import exact, families
from prt_bench.stability.cell import Measured, Member, case
from prt_bench.stability.nist import regressions
from prt_bench.stability.routes import F64, Route

_TARGETS = 3
_WELL_POSED = 1 / 300
_SLACK = 30


class Problem(NamedTuple):
    """A ridge regression as it arrived, with the factor of its relative ridge."""

    x: np.ndarray
    targets: np.ndarray
    factor: float

    @property
    def damping(self) -> float:
        """λ = factor ‖x‖²_F / M in float64."""
        x = self.x.astype(np.float64)
        return self.factor * float(np.sum(x * x)) / len(x)

    @property
    def kappa(self) -> float:
        """κ_λ."""
        values = np.linalg.svd(self.x.astype(np.float64), compute_uv=False)
        return float(np.sqrt((values[0] ** 2 + self.damping) / (values[-1] ** 2 + self.damping)))


def ridge_solvers() -> dict[str, Any]:
    """What solves ridge regressions."""
    return {"ridge": lambda x, targets, damping: linalg.ridge(x, targets, damping)}


def _factors(route: Route) -> tuple[float, ...]:
    return (1e-2, 1e-5, 1e-7) if route.compute is np.float32 else (1e-2, 1e-10, 1e-20, 1e-24)


def problem(matrix: np.ndarray, factor: float, route: Route, seed: int = 0) -> Problem:
    """Targets that a matrix of norm 1 explains, so that the condition is κ_λ and not its square."""
    x = route.arrive(matrix)
    w = np.random.default_rng([seed, 7]).normal(size=(_TARGETS, len(x)))
    return Problem(x, (w @ x.astype(np.float64)).astype(route.compute), factor)


def _problems(route: Route, family: Any) -> Iterator[Member]:
    for shape in (families.WIDE, families.TALL):
        for name, matrix in family(shape):
            for factor in _factors(route):
                posed = _arrived(matrix, factor, route)
                if posed is not None:
                    yield Member(f"{name}, {shape[0]} × {shape[1]}, ridge {factor:g}", posed)


def _arrived(matrix: np.ndarray, factor: float, route: Route) -> Problem | None:
    """The problem, unless the dtype cannot hold its data or its λ, or it is too ill-conditioned to have digits left."""
    if not np.all(np.isfinite(route.arrive(matrix))):
        return None
    posed = problem(matrix, factor, route)
    held = posed.damping > np.finfo(route.compute).tiny / route.eps
    return posed if held and posed.kappa * route.eps < _WELL_POSED else None


def _forward_error(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    damping = route.compute(posed.damping)
    found = np.asarray(solver(jnp.asarray(posed.x), jnp.asarray(posed.targets), jnp.asarray(damping)), np.float64)
    wanted = exact.ridge(posed.x, posed.targets, float(damping))
    unit = route.eps * posed.kappa
    yield Measured(float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted)), _SLACK * unit, unit)


@case(
    "A2", "ridge of conditioned matrices (dlatms modes)", subjects=ridge_solvers,
    family=lambda route: _problems(route, lambda shape: families.conditioned(route, shape)),
)  # fmt: skip
def modes(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A2, A3: forward error for wide and tall data, over the range of conditions that the dtype carries."""
    return _forward_error(solver, posed, route)


@case(
    "A2", "ridge of scaled and sparse matrices (dlatb4)", subjects=ridge_solvers,
    family=lambda route: _problems(route, lambda shape: families.scaled(route, shape)),
)  # fmt: skip
def scales(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A2, A5: dark points and lightings, and light as small or large as its square may be."""
    return _forward_error(solver, posed, route)


@case(
    "A2", "ridge of Hilbert, Läuchli, Kahan, Vandermonde, Golub, shaw", subjects=ridge_solvers,
    family=lambda route: _problems(route, families.classics),
)  # fmt: skip
def classics(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A2: the matrices that normal equations are known to fail on."""
    return _forward_error(solver, posed, route)


@case(
    "A2", "NIST regressions with certified coefficients", subjects=ridge_solvers, routes=(F64,),
    family=lambda route: (Member(name, data) for name, data in regressions().items()),
)  # fmt: skip
def certified(solver: Any, posed: Any, route: Route) -> Iterator[Measured]:
    """Longley, Wampler1 to 5 and Filip at λ = 0, each predictor in units of its own norm.

    The error bound of least squares has κ² times the tangent of the angle between response and predictors besides κ.
    """
    size = np.linalg.norm(posed.design, axis=1, keepdims=True)
    x = posed.design / size
    found = np.asarray(solver(jnp.asarray(x), jnp.asarray(posed.response), jnp.asarray(0.0)))[0]
    wanted = posed.certified * size[:, 0]
    values = np.linalg.svd(x, compute_uv=False)
    kappa, fitted = values[0] / values[-1], wanted @ x
    misfit = np.linalg.norm(posed.response - fitted) / (values[0] * np.linalg.norm(wanted))
    unit = route.eps * kappa * (1.0 + kappa * misfit)
    yield Measured(float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted)), _SLACK * unit, unit)


def _coincident(route: Route) -> Iterator[Member]:
    for shape in (families.WIDE, families.TALL):
        for seed in families.SEEDS:
            for copies in (2, 5):
                matrix = np.random.default_rng([seed, copies]).normal(size=shape)
                matrix[1:copies] = matrix[0]
                yield Member(f"{copies} of {shape[0]} × {shape[1]}, seed {seed}", (problem(matrix, 0.0, route), copies))


@case("A1", "coincident measurement points without ridge", subjects=ridge_solvers, family=_coincident)
def coincident(solver: Any, posed: tuple[Problem, int], route: Route) -> Iterator[Measured]:
    """A1: X Xᵀ is singular; the minimum-norm solution shares the weight among the copies."""
    (x, targets, _), copies = posed
    found = np.asarray(solver(jnp.asarray(x), jnp.asarray(targets), jnp.zeros((), x.dtype)), np.float64)
    merged = x[copies - 1 :].astype(np.float64)
    merged[0] *= np.sqrt(copies)
    if merged.shape[0] > merged.shape[1]:
        wanted = np.asarray(targets, np.float64) @ np.linalg.pinv(merged)  # full column rank and well conditioned
    else:
        wanted = exact.ridge(merged, targets, 0.0)
    spread = wanted[:, :1] / np.sqrt(copies)
    wanted = np.concatenate([np.repeat(spread, copies, axis=1), wanted[:, 1:]], axis=1)
    values = np.linalg.svd(merged, compute_uv=False)
    unit = route.eps * float(values[0] / values[-1])
    yield Measured(float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted)), _SLACK * unit, unit)


def _nearly_coincident(route: Route) -> Iterator[Member]:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        matrix = rng.normal(size=families.WIDE)
        matrix[1] = matrix[0] + 1e-7 * rng.normal(size=families.WIDE[1])
        posed = problem(matrix, 1e-6, route, seed)
        noisy = (posed.targets * (1 + 3e-7 * rng.normal(size=posed.targets.shape))).astype(route.compute)
        yield Member(f"seed {seed}", posed._replace(targets=noisy))


@case("A1b", "measurement points 1e-7 apart", subjects=ridge_solvers, family=_nearly_coincident)
def nearly_coincident(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A1b: rounding of the targets must not become weights of hundreds."""
    found = solver(jnp.asarray(posed.x), jnp.asarray(posed.targets), jnp.asarray(route.compute(posed.damping)))
    yield Measured(float(np.linalg.norm(np.asarray(found, np.float64), 2)), 20.0)


def _plain(route: Route, count: int = 3) -> Iterator[Member]:
    for shape in (families.WIDE, families.TALL):
        for seed in range(count):
            rng = np.random.default_rng(seed)
            matrix = families.with_spectrum(families.spectrum(3, min(shape), 1e3, rng), shape, rng)
            yield Member(f"{shape[0]} × {shape[1]}, seed {seed}", problem(matrix, 1e-4, route, seed))


@case("A3", "more measurement points than lightings", subjects=ridge_solvers, family=_plain)
def within_range(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A3: nothing outside of the span of the training light is invented."""
    w = np.asarray(solver(posed.x, posed.targets, jnp.asarray(route.compute(posed.damping))), np.float64)
    x = posed.x.astype(np.float64)
    outside = w - w @ x @ np.linalg.pinv(x)
    unit = route.eps * posed.kappa
    yield Measured(float(np.linalg.norm(outside) / np.linalg.norm(w)), _SLACK * unit, unit)


@case("A5", "unit of light and repetition of the data", subjects=ridge_solvers, family=_plain)
def relative(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A5: M(sX, sC) = M(X, C) with the relative ridge, and the same for the data twice over."""

    def fitted(x: np.ndarray, targets: np.ndarray) -> np.ndarray:
        damping = linalg.relative_damping(jnp.asarray(x), jnp.asarray(posed.factor, x.dtype))
        return np.asarray(solver(jnp.asarray(x), jnp.asarray(targets), damping), np.float64)

    plain = fitted(posed.x, posed.targets)
    unit = route.eps * posed.kappa
    for x, targets in (
        *((route.compute(s) * posed.x, route.compute(s) * posed.targets) for s in (1e-3, 3.0, 1e6)),
        (np.tile(posed.x, 2), np.tile(posed.targets, 2)),
    ):
        yield Measured(float(np.linalg.norm(fitted(x, targets) - plain) / np.linalg.norm(plain)), _SLACK * unit, unit)


@case("A11", "norm of the matrix against the ridge", subjects=ridge_solvers, family=_plain)
def monotone(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """A11: ‖W‖ never grows with λ, over the range of λ that the dtype carries."""
    low = 1e-14 if route.compute is np.float64 else 1e-7
    norms = [
        float(np.linalg.norm(np.asarray(solver(posed.x, posed.targets, jnp.asarray(route.compute(damping))), float)))
        for damping in np.geomspace(low, 1.0, 25)
    ]
    growth = np.max(np.diff(norms) / norms[:-1])
    yield Measured(max(float(growth), 0.0), _SLACK * route.eps * posed.kappa)


@case("D7", "inverting smooth transfer, x = T w", subjects=ridge_solvers, family=lambda route: _smooth(route))
def smooth_transfer(solver: Any, posed: Problem, route: Route) -> Iterator[Measured]:
    """D7: coefficients from noisy measurements of smooth light, whose matrix has a condition beyond any dtype.

    The answer keeps its size; the error that noise of 0.1 % causes stays below one half.
    """
    w = np.asarray(solver(posed.x, posed.targets, jnp.asarray(route.compute(posed.damping))), np.float64)
    wanted = np.outer(np.ones(_TARGETS), 2 * np.exp(-6 * (np.linspace(-1, 1, len(posed.x)) - 0.3) ** 2) + 0.5)
    yield Measured(float(np.linalg.norm(w - wanted) / np.linalg.norm(wanted)), 0.5)


def _smooth(route: Route) -> Iterator[Member]:
    size = min(families.WIDE)
    wanted = 2 * np.exp(-6 * (np.linspace(-1, 1, size) - 0.3) ** 2) + 0.5
    kernel = np.zeros(families.WIDE)
    kernel[:, :size] = families.shaw(size)
    for seed in range(3):
        x = route.arrive(kernel)
        clean = np.outer(np.ones(_TARGETS), wanted) @ kernel
        noise = 1e-3 * np.random.default_rng(seed).normal(size=clean.shape) * np.abs(clean).max()
        yield Member(f"shaw, seed {seed}", Problem(x, (clean + noise * (clean != 0)).astype(route.compute), 1e-4))


def svds() -> dict[str, Any]:
    """What decomposes matrices; jitted anew for every matrix, so that its routes can be made to fail."""
    return {"svd": lambda matrix: jax.jit(lambda m: linalg.svd(m))(matrix)}


def _broken(matrix: jax.Array) -> tuple[jax.Array, ...]:
    return tuple(jnp.full_like(factor, jnp.nan) for factor in jnp.linalg.svd(matrix, full_matrices=False))


@case(
    "A0", "SVD with failing LAPACK drivers", subjects=svds,
    family=lambda route: (
        Member(f"{failing} drivers fail, {shape}", (failing, np.random.default_rng(failing).normal(size=shape)))
        for failing in range(3) for shape in ((9, 5), (5, 9))
    ),
)  # fmt: skip
def drivers(decompose: Any, data: tuple[int, np.ndarray], route: Route) -> Iterator[Measured]:
    """Divide and conquer now and then returns NaN on clean data: the next driver takes over."""
    failing, matrix = data
    matrix = route.arrive(matrix)
    with patch.object(linalg, "_ROUTES", (*[_broken] * failing, *linalg._ROUTES[failing:])):
        u, s, vt = (np.asarray(factor, np.float64) for factor in decompose(jnp.asarray(matrix)))
    yield Measured(float(np.linalg.norm(u * s @ vt - matrix) / s[0]), _SLACK * route.eps, route.eps)


_svd = jax.jit(lambda matrix: linalg.svd(matrix))


def _matrices(route: Route) -> Iterator[Member]:
    for name, matrix in (*families.conditioned(route, families.WIDE), *families.classics(families.WIDE)):
        arrived = route.arrive(matrix)
        if np.all(np.isfinite(arrived)):
            yield Member(name, arrived)


@case("A0", "SVD of all families", subjects=lambda: {"svd": _svd}, family=_matrices)
def backward(decompose: Any, matrix: np.ndarray, route: Route) -> Iterator[Measured]:
    """Backward error and orthonormality."""
    u, s, vt = (np.asarray(factor, np.float64) for factor in decompose(jnp.asarray(matrix)))
    unit = len(s) * route.eps
    yield Measured(float(np.linalg.norm(u * s @ vt - matrix) / s[0]), _SLACK * unit, unit)
    for frame in (u, vt.T):
        yield Measured(float(np.abs(frame.T @ frame - np.eye(len(s))).max()), _SLACK * unit, unit)
