"""Seeded families of hard matrices for the linear solver and the bases.

After LAPACK's generators (dlatms modes, dlatb4 scales) and the classics of least squares. A matrix holds measurement points
in rows and lightings in columns; zeros fill it up to a common shape, as dark points and lightings would.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from prt_bench.stability.routes import Route

WIDE, TALL = (24, 40), (40, 24)
SEEDS = (0, 1)

Matrix = Float[np.ndarray, "M n"]


def spectrum(mode: int, size: int, condition: float, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Singular values of dlatms: 1 one large, 2 one small, 3 geometric, 4 arithmetic, 5 log-uniform."""
    steps = np.arange(size) / (size - 1)
    values = {
        1: np.where(steps == 0, 1.0, 1.0 / condition),
        2: np.where(steps == 1, 1.0 / condition, 1.0),
        3: condition**-steps,
        4: 1.0 - steps * (1.0 - 1.0 / condition),
        5: np.sort(condition ** -rng.uniform(size=size))[::-1],
    }
    return values[mode]


def with_spectrum(values: Float[np.ndarray, " k"], shape: tuple[int, int], rng: np.random.Generator) -> Matrix:
    """A matrix with these singular values between random orthonormal frames."""
    left, right = (np.linalg.qr(rng.normal(size=(size, len(values))))[0] for size in shape)
    return left * values @ right.T


def conditioned(route: Route, shape: tuple[int, int]) -> Iterator[tuple[str, Matrix]]:
    """Modes of dlatms at conditions up to what the route can carry."""
    for condition in (1e2, 1e4) if route.compute is np.float32 else (1e2, 1e8, 1e12):
        for mode in range(1, 6):
            for seed in SEEDS:
                rng = np.random.default_rng([seed, mode, int(np.log10(condition))])
                values = spectrum(mode, min(shape), condition, rng)
                yield f"mode {mode}, condition {condition:.0e}, seed {seed}", with_spectrum(values, shape, rng)


def scaled(route: Route, shape: tuple[int, int]) -> Iterator[tuple[str, Matrix]]:
    """Scales of dlatb4: zero rows and columns, triangles, and light near the square root of underflow and of overflow."""
    root = np.exp2(np.finfo(route.data if route.data in (np.float64, np.float32) else np.float16).maxexp // 2 - 8)
    for seed in SEEDS:
        plain = np.random.default_rng(seed).normal(size=shape)
        changed = {
            "upper triangle": np.triu(plain),
            "lower triangle": np.tril(plain),
            "first row zero": plain * (np.arange(shape[0]) > 0)[:, None],
            "last column zero": plain * (np.arange(shape[1]) < shape[1] - 1),
            "half of the rows zero": plain * (np.arange(shape[0]) < shape[0] // 2)[:, None],
            "near underflow": plain / root,
            "near overflow": plain * root,
        }
        yield from ((f"{name}, seed {seed}", matrix) for name, matrix in changed.items())


def classics(shape: tuple[int, int]) -> Iterator[tuple[str, Matrix]]:
    """Named matrices, each with a seeded parameter where it has one."""
    i, j = np.indices(shape)
    k = min(shape)
    rows, columns = np.indices((k, k))
    yield "Hilbert", 1.0 / (i + j + 1.0)
    for mu in (1e-3, 1e-7):
        yield f"Läuchli, μ = {mu:g}", _fill(np.vstack([np.ones(k - 1), mu * np.eye(k - 1)]), shape)
    for angle in (1.2, 0.9):
        cosine, sine = np.cos(angle), np.sin(angle)
        triangle = np.where(rows == columns, 1.0, np.where(columns > rows, -cosine, 0.0))
        yield f"Kahan, θ = {angle:g}", _fill(sine**rows * triangle, shape)
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        yield f"Vandermonde, seed {seed}", np.sort(rng.uniform(0, 1, shape[1])) ** i
        lower, upper = (np.round(3 * rng.normal(size=(k, k))) for _ in range(2))
        factors = np.tril(lower, -1) + np.eye(k), np.triu(upper, 1) + np.eye(k)
        yield f"Golub, integer factors, seed {seed}", _fill(factors[0][:, :8] @ factors[1][:8], shape)
    yield "Golub and Riley, inverse Hilbert columns", _fill(_inverse_hilbert(6)[:, :5], shape)
    yield "shaw", _fill(shaw(k), shape)


def shaw(size: int) -> Float[np.ndarray, "n n"]:
    """Hansen's one-dimensional image restoration: a slit seen through another, the kernel of smooth light."""
    angle = (np.arange(size) + 0.5) * np.pi / size - np.pi / 2
    s, t = np.meshgrid(angle, angle, indexing="ij")
    phase = np.pi * (np.sin(s) + np.sin(t))
    return (np.cos(s) + np.cos(t)) ** 2 * np.sinc(phase / np.pi) ** 2 * np.pi / size


def _inverse_hilbert(size: int) -> Float[np.ndarray, "n n"]:
    from scipy.linalg import invhilbert

    return invhilbert(size)


def _fill(matrix: Matrix, shape: tuple[int, int]) -> Matrix:
    filled = np.zeros(shape)
    rows, columns = matrix.shape if matrix.shape[0] <= shape[0] and matrix.shape[1] <= shape[1] else matrix.T.shape
    filled[:rows, :columns] = matrix if matrix.shape == (rows, columns) else matrix.T
    return filled
