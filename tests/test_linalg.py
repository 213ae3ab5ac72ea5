"""Values and derivatives are separate claims: each has its own tests, on the inputs that break the printed formulas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench import linalg
from prt_bench.linalg import (
    cut_gap,
    leading_basis,
    leave_one_out,
    orthonormal,
    relative_damping,
    ridge,
    rounding_floor,
    safe_norm,
    svd,
)

EPS = np.finfo(float).eps


def matrix_of(singular_values, rows, columns, seed=0):
    rng = np.random.default_rng(seed)
    count = len(singular_values)
    left, right = (np.linalg.qr(rng.normal(size=(size, count)))[0] for size in (rows, columns))
    return jnp.asarray(left * np.asarray(singular_values) @ right.T), left


def targets_for(columns, seed=1):
    return jnp.asarray(np.random.default_rng(seed).normal(size=(3, columns)))


def assert_gradient(function, *arguments):
    """The gradient in every argument against central differences along a random direction."""
    rng = np.random.default_rng(7)
    arguments = [jnp.asarray(argument, float) for argument in arguments]
    weight = rng.normal(size=jax.eval_shape(function, *arguments).shape)
    loss = jax.jit(lambda arguments: jnp.sum(weight * function(*arguments)))
    slopes = jax.jit(jax.grad(loss))(arguments)
    for index, slope in enumerate(slopes):
        direction = rng.normal(size=slope.shape)
        ahead, behind = (
            loss([a + step * direction if i == index else a for i, a in enumerate(arguments)]) for step in (1e-6, -1e-6)
        )
        size = np.linalg.norm(slope) * np.linalg.norm(direction)
        np.testing.assert_allclose(np.sum(slope * direction), (ahead - behind) / 2e-6, atol=1e-6 * max(size, 1.0))


# --- ridge: values -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(7, 12), (12, 7), (9, 9)])
def test_ridge_equals_primal_and_dual_form(shape):
    """A0: the printed formula mixes the transposes of these two forms, and type-checks for M = N alone."""
    x = jnp.asarray(np.random.default_rng(0).normal(size=shape))
    c, damping = targets_for(shape[1]), 0.3
    primal = c @ x.T @ np.linalg.inv(x @ x.T + damping * np.eye(shape[0]))
    dual = c @ np.linalg.inv(x.T @ x + damping * np.eye(shape[1])) @ x.T
    found = ridge(x, c, jnp.asarray(damping))
    np.testing.assert_allclose(found, primal, atol=1e-13)
    np.testing.assert_allclose(found, dual, atol=1e-13)


def test_ridge_without_damping_on_coincident_points_is_the_minimum_norm_solution():
    """A1: five coincident measurement points make X Xᵀ singular."""
    x = jnp.asarray(np.random.default_rng(0).normal(size=(12, 30))).at[1:6].set(0.0)
    x = x.at[1:6].set(x[0])
    c = targets_for(30)
    found = ridge(x, c, jnp.asarray(0.0))
    np.testing.assert_allclose(found, c @ np.linalg.pinv(x, rcond=1e-12), atol=1e-13)
    np.testing.assert_allclose(found[:, :6], jnp.repeat(found[:, :1], 6, axis=1), atol=1e-13)


def test_nearly_coincident_points_do_not_blow_the_matrix_up():
    """A1b: rows 1e-7 apart, seen in float32, with targets that carry float32 rounding."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(8, 40))
    x[1] = x[0] + 1e-7 * rng.normal(size=40)
    c = rng.normal(size=(3, 8)) @ x
    x, c = (jnp.asarray(a.astype(np.float32).astype(float)) for a in (x, c))
    assert float(jnp.linalg.norm(ridge(x, c, relative_damping(x, 1e-6)), 2)) < 10


@pytest.mark.parametrize("condition", [1e4, 1e8, 1e12])
@pytest.mark.parametrize("shape", [(24, 40), (40, 24)])
def test_ridge_forward_error_stays_within_its_condition(condition, shape):
    """A2: against the same problem solved in its exact singular system; the bound is 30 · eps · κ_λ."""
    rng = np.random.default_rng(2)
    values = np.geomspace(1.0, 1.0 / condition, 24)
    p, q = (np.linalg.qr(rng.normal(size=(size, 24)))[0] for size in shape)
    w_true = rng.normal(size=(3, 24)) @ p.T
    x, c = p * values @ q.T, (w_true @ p) * values @ q.T
    damping = values[-1] ** 2
    expected = (w_true @ p) * (values**2 / (values**2 + damping)) @ p.T
    kappa = np.sqrt((1 + damping) / (values[-1] ** 2 + damping))
    error = np.linalg.norm(ridge(jnp.asarray(x), jnp.asarray(c), jnp.asarray(damping)) - expected) / np.linalg.norm(
        expected
    )
    assert error <= 30 * EPS * kappa


def test_more_points_than_lightings_has_the_rank_of_the_lightings():
    """A3: M > N; nothing outside the span of the training light is invented."""
    x = jnp.asarray(np.random.default_rng(0).normal(size=(30, 10)))
    w = ridge(x, targets_for(10), relative_damping(x, 1e-3))
    outside = jnp.eye(30) - x @ jnp.linalg.pinv(x)
    assert float(jnp.abs(w @ outside).max()) < 1e-13 * float(jnp.abs(w).max())
    assert int(jnp.linalg.matrix_rank(w)) == 3


def test_relative_ridge_ignores_the_unit_of_light_and_repetition():
    """A5: M(sX, sC) = M(X, C), and so for the data twice over."""
    x, c = jnp.asarray(np.random.default_rng(0).normal(size=(8, 20))), targets_for(20)
    plain = ridge(x, c, relative_damping(x, 1e-2))
    for scale in (1e-3, 1e3):
        np.testing.assert_allclose(ridge(scale * x, scale * c, relative_damping(scale * x, 1e-2)), plain, rtol=1e-11)
    twice = jnp.concatenate([x, x], axis=1)
    np.testing.assert_allclose(
        ridge(twice, jnp.concatenate([c, c], axis=1), relative_damping(twice, 1e-2)), plain, rtol=1e-11
    )


def test_matrix_norm_falls_with_damping():
    """A11: ‖M‖ is monotone in λ over twelve decades."""
    x, _ = matrix_of(np.geomspace(1, 1e-6, 12), 12, 30)
    norms = [float(jnp.linalg.norm(ridge(x, targets_for(30), jnp.asarray(d)))) for d in np.geomspace(1e-14, 1e-2, 30)]
    assert np.all(np.diff(norms) <= 0)


# --- ridge: derivatives ------------------------------------------------------------------------------------------------


def symmetric_rig():
    """Two mirrored halves: every singular value of X appears twice."""
    half = np.random.default_rng(3).normal(size=(5, 7))
    return jnp.asarray(np.block([[half, 0 * half], [0 * half, half]]))


HARD_INPUTS = {
    "generic wide": lambda: jnp.asarray(np.random.default_rng(0).normal(size=(6, 11))),
    "generic tall": lambda: jnp.asarray(np.random.default_rng(0).normal(size=(11, 6))),
    "symmetric": symmetric_rig,
    "symmetric tall": lambda: symmetric_rig().T,
    "duplicate point": lambda: HARD_INPUTS["generic wide"]().at[1].set(HARD_INPUTS["generic wide"]()[0]),
    "duplicate lighting": lambda: HARD_INPUTS["generic tall"]().at[:, 1].set(HARD_INPUTS["generic tall"]()[:, 0]),
    "dark point": lambda: HARD_INPUTS["generic wide"]().at[2].set(0.0),
    "dark lighting": lambda: HARD_INPUTS["generic tall"]().at[:, 2].set(0.0),
    "rank 2": lambda: matrix_of([2.0, 1.0], 8, 9)[0],
}


@pytest.mark.parametrize("case", HARD_INPUTS)
def test_ridge_gradient_matches_differences(case):
    """H1: through the singular vectors it is finite and wrong by several percent on the symmetric rig, NaN elsewhere."""
    x = HARD_INPUTS[case]()
    c = targets_for(x.shape[1])
    assert_gradient(lambda x, c, factor: ridge(x, c, relative_damping(x, factor)), x, c, 0.05)


# --- leave-one-out -----------------------------------------------------------------------------------------------------


def refitted(x, c, damping, group=1):
    """Brute force: fit without each group of columns, and look at what was left out."""
    errors = np.empty(c.shape)
    for at in range(0, x.shape[1], group):
        out = np.arange(at, at + group)
        p, s, qt = np.linalg.svd(np.delete(x, out, axis=1), full_matrices=False)
        w = np.delete(c, out, axis=1) @ qt.T * (s / (s * s + damping)) @ p.T
        errors[:, out] = c[:, out] - w @ x[:, out]
    return errors


@pytest.mark.parametrize("shape", [(7, 12), (12, 6), (9, 9)])
@pytest.mark.parametrize("group", [1, 3])
@pytest.mark.parametrize("damping", [10.0, 1e-2, 1e-6])
def test_leave_one_out_equals_refitting(shape, group, damping):
    """A12: each column, or each group of columns, predicted by the others."""
    x, c = np.random.default_rng(0).normal(size=shape), np.asarray(targets_for(shape[1]))
    expected = refitted(x, c, damping, group)
    size = np.abs(expected).max()
    np.testing.assert_allclose(leave_one_out(x, c, damping, group), expected, atol=1e-11 * size)


def test_leave_one_out_does_not_cancel_at_a_small_ridge():
    """A12: at λ = 1e-10 the textbook r / (1 − h) is a quotient of roundings; in spectral form λ cancels beforehand."""
    rng = np.random.default_rng(1)
    x, c = rng.normal(size=(40, 25)), rng.normal(size=(2, 25))
    expected, damping = refitted(x, c, 1e-10), 1e-10
    weights = np.linalg.solve(x @ x.T + damping * np.eye(40), x)
    textbook = (c - c @ x.T @ weights) / (1.0 - np.sum(x * weights, axis=0))
    error, naive = (
        np.abs(found - expected).max() / np.abs(expected).max()
        for found in (np.asarray(leave_one_out(x, c, damping)), textbook)
    )
    assert error < 1e-11 < 1e-4 < naive


def test_leave_one_out_sees_through_white_light_only_by_whole_lightings():
    """Three equal channels: left out one by one, each is predicted by its twins, whatever the targets."""
    rng = np.random.default_rng(0)
    x, c = (np.repeat(rng.normal(size=(rows, 8)), 3, axis=1) for rows in (40, 3))
    assert np.abs(leave_one_out(x, c, 1e-6)).max() < 1e-6
    np.testing.assert_allclose(leave_one_out(x, c, 1e-6, group=3), refitted(x, c, 1e-6, 3), rtol=1e-6)


@pytest.mark.parametrize(
    ("case", "group"),
    [("generic wide", 1), ("symmetric", 2), ("duplicate lighting", 1), ("dark point", 1), ("rank 2", 3)],
)
def test_leave_one_out_gradient_matches_differences(case, group):
    x = HARD_INPUTS[case]()
    x = x[:, : x.shape[1] // group * group]
    assert_gradient(lambda x, c, d: leave_one_out(x, c, d, group), x, targets_for(x.shape[1]), 0.05)


def test_leave_one_out_for_many_ridges_at_once():
    x, c = jnp.asarray(np.random.default_rng(0).normal(size=(6, 9))), targets_for(9)
    grid = jnp.geomspace(1e-6, 1.0, 5)
    together = jax.vmap(lambda damping: leave_one_out(x, c, damping))(grid)
    for damping, found in zip(grid, together, strict=True):
        np.testing.assert_allclose(found, leave_one_out(x, c, damping), rtol=1e-12)


# --- leading basis -----------------------------------------------------------------------------------------------------


def test_basis_is_orthonormal_and_complete_for_small_singular_values():
    """B1: forty values over six decades; the Gram matrix alone loses the orthogonality of the small ones."""
    matrix, left = matrix_of(np.geomspace(1, 1e-6, 40), 300, 60)
    u, values = leading_basis(matrix, 40, rounding_floor(matrix))
    assert float(jnp.abs(u.T @ u - jnp.eye(40)).max()) <= 30 * 40 * EPS
    np.testing.assert_allclose(values[:30], np.geomspace(1, 1e-6, 40)[:30], rtol=1e-4)
    np.testing.assert_allclose(u[:, :20] @ u[:, :20].T, left[:, :20] @ left[:, :20].T, atol=1e-9)


def test_basis_finds_what_the_gram_matrix_cannot_see():
    """B1: a cut at 1e-11 σ₁ in float64; by the Gram matrix alone the error is ten times that of the best basis."""
    matrix = jnp.asarray(1.0 / (1.0 + np.add.outer(np.arange(60), np.arange(24))))
    u, _ = leading_basis(matrix, 12, rounding_floor(matrix))
    best = np.linalg.norm(np.linalg.svd(matrix, compute_uv=False)[12:])
    assert np.linalg.norm(matrix - u @ (u.T @ matrix)) < 1.1 * best + 100 * EPS


def test_basis_stops_at_the_effective_rank():
    """B2: sixteen vectors asked of a rank-8 matrix: eight, and eight columns of zeros."""
    matrix, left = matrix_of(np.geomspace(1, 1e-3, 8), 200, 50)
    u, _ = leading_basis(matrix, 16, rounding_floor(matrix))
    assert int(jnp.sum(jnp.any(u != 0, axis=0))) == 8
    np.testing.assert_allclose(u @ u.T, left @ left.T, atol=1e-12)


def test_constant_data_has_rank_zero_after_centring():
    """B3: what is left of equal columns is rounding; a tolerance relative to *it* would find rank 1."""
    column = np.random.default_rng(0).uniform(0.1, 1.0, (200, 1))
    matrix = jnp.asarray(np.repeat(column, 30, axis=1) * (1 + 1e-16))
    centred = matrix - jnp.mean(matrix, axis=1, keepdims=True) * (1 + 2e-16)
    assert float(jnp.abs(centred).max()) > 0
    u, _ = leading_basis(centred, 4, rounding_floor(matrix))
    assert not bool(jnp.any(u))


def test_projector_ignores_the_order_of_columns():
    """B5: bases differ by signs and rotations, their projectors do not."""
    matrix, _ = matrix_of([3.0, 2.0, 2.0, 1.0, 0.5], 40, 12)
    u, _ = leading_basis(matrix, 3, 0.0)
    shuffled, _ = leading_basis(matrix[:, np.random.default_rng(1).permutation(12)], 3, 0.0)
    np.testing.assert_allclose(shuffled @ shuffled.T, u @ u.T, atol=1e-13)


SPECTRA = {
    "distinct": [3.0, 2.0, 1.5, 1.0, 0.5],
    "repeated above the cut": [2.0, 2.0, 2.0, 1.0, 0.5],
    "repeated below the cut": [3.0, 2.0, 1.5, 0.5, 0.5],
    "rank equal to the cut": [3.0, 2.0, 2.0],
}


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_projector_gradient_matches_differences(spectrum):
    """B4: the derivative of an SVD divides by every gap; the projector's only by those across the cut."""
    matrix, _ = matrix_of(SPECTRA[spectrum], 14, 6)
    rng = np.random.default_rng(5)
    left, right = (jnp.asarray(rng.normal(size=(size, size))) for size in matrix.shape)

    def projector(s):  # moves the matrix within its rank: leaving a rank is not smooth
        u, _ = leading_basis((jnp.eye(14) + s[0] * left) @ matrix @ (jnp.eye(6) + s[1] * right), 3, 1e-9)
        return u @ u.T

    assert_gradient(projector, [0.1, 0.05])


def test_projector_gradient_on_exactly_equal_singular_values():
    """B4: equal to the last bit, where the derivative of an SVD is 0/0."""
    matrix = jnp.zeros((9, 5)).at[jnp.arange(5), jnp.arange(5)].set(jnp.asarray([2.0, 2.0, 2.0, 1.0, 1.0]))
    assert_gradient(lambda m: (lambda u: u @ u.T)(leading_basis(m, 3, 1e-9)[0]), matrix)


def test_projector_gradient_is_finite_where_rank_is_missing_or_the_cut_has_no_gap():
    for values in ([2.0, 1.0], [3.0, 1.0, 1.0, 1.0, 0.5], [0.0]):
        matrix, _ = matrix_of(values, 14, 6)
        slope = jax.jit(jax.grad(lambda m: jnp.sum(jnp.sin(leading_basis(m, 3, rounding_floor(m))[0]))))(matrix)
        assert bool(jnp.all(jnp.isfinite(slope)))


def test_no_gap_at_the_cut_is_seen():
    assert cut_gap(jnp.asarray([3.0, 1.0, 1.0, 0.5]), 2) == 0
    assert cut_gap(jnp.asarray([3.0, 1.0, 1.0, 0.5]), 3) == pytest.approx(0.5 / 3)
    assert cut_gap(jnp.asarray([3.0, 1.0]), 2) == 1


def test_orthonormal_spans_the_columns_and_nothing_else():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(30, 4)) * [1.0, 1e-4, 10.0, 1.0]
    columns[:, 3] = columns[:, 0] + columns[:, 2]
    q = orthonormal(jnp.asarray(columns))
    np.testing.assert_allclose(q @ (q.T @ columns), columns, atol=1e-12)
    assert int(jnp.sum(jnp.any(q != 0, axis=0))) == 3


# --- SVD and norms -----------------------------------------------------------------------------------------------------


def broken(matrix):
    return tuple(jnp.full_like(factor, jnp.nan) for factor in jnp.linalg.svd(matrix, full_matrices=False))


@pytest.mark.parametrize("failing", [0, 1, 2])
@pytest.mark.parametrize("shape", [(9, 5), (5, 9)])
def test_svd_survives_failing_routes(monkeypatch, failing, shape):
    """A driver that returns NaN on clean data (seen with gesdd) is replaced by the next, inside jit too."""
    routes = [broken] * failing + list(linalg._ROUTES[failing:])
    monkeypatch.setattr(linalg, "_ROUTES", tuple(routes))
    matrix = jnp.asarray(np.random.default_rng(0).normal(size=shape))
    u, s, vt = jax.jit(lambda m: svd(m))(matrix)
    np.testing.assert_allclose(u * s @ vt, matrix, atol=1e-13)
    np.testing.assert_allclose(s, np.linalg.svd(matrix, compute_uv=False), atol=1e-13)


def test_svd_does_not_hide_nan():
    assert bool(jnp.all(jnp.isnan(svd(jnp.full((3, 2), jnp.nan))[1])))


def test_norm_has_gradient_zero_at_zero_and_a_wide_range():
    """C5, A7."""
    slope = jax.jit(jax.grad(lambda x: safe_norm(x, 0)[0]))
    np.testing.assert_array_equal(slope(jnp.zeros(2)), np.zeros(2))
    x = jnp.asarray([3.0, 4.0])
    np.testing.assert_allclose(slope(x), [0.6, 0.8])
    for scale in (1e-200, 1e200):
        np.testing.assert_allclose(safe_norm(scale * x, 0), [5 * scale])
