"""Values against scipy and closed forms, orthonormality, sum rules, and gradients against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import SpecError
from prt_bench.spherical import azimuths, bands, count, evaluate, order_of, quadrature


@pytest.mark.parametrize(("order", "tolerance"), [(1, 1e-15), (2, 1e-15), (5, 1e-14), (13, 1e-13), (30, 1e-12)])
def test_values_are_scipys(directions, oracle, order, tolerance):
    np.testing.assert_allclose(evaluate(directions, order), oracle(directions, order), atol=tolerance)


def test_the_first_bands_are_the_printed_polynomials(directions):
    x, y, z = directions.T
    a, b, c = np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi)), np.sqrt(5 / (16 * np.pi))
    wanted = [
        np.full_like(x, np.sqrt(1 / (4 * np.pi))), a * y, a * z, a * x,
        b * x * y, b * y * z, c * (3 * z * z - 1), b * x * z, b / 2 * (x * x - y * y),
    ]  # fmt: skip
    np.testing.assert_allclose(evaluate(directions, 3), np.stack(wanted, axis=1), atol=1e-15)
    assert a == pytest.approx(0.4886025119)


@pytest.mark.parametrize("order", [5, 12, 13, 30])
def test_float32_loses_little(directions, order):
    """Orders 12 and 13: on either side of where rounding near the poles is taken care of."""
    single = directions.astype(np.float32)
    found = evaluate(single, order)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, evaluate(single.astype(float), order), atol=1e-5)


@pytest.mark.parametrize("order", [1, 2, 5, 10, 20])
def test_harmonics_are_orthonormal(order):
    points, weight = quadrature(2 * (order - 1))
    harmonics = np.asarray(evaluate(points, order))
    np.testing.assert_allclose(harmonics.T * weight @ harmonics, np.eye(order**2), atol=1e-13)


def test_the_quadrature_integrates_monomials():
    """∫ z⁴ x² dω = 4π · 3!!/(7·5·3) and odd powers vanish, up to the degree promised."""
    points, weight = quadrature(6)
    x, y, z = points.T
    assert weight @ (z**4 * x**2) == pytest.approx(4 * np.pi * 3 / 105, rel=1e-14)
    assert weight @ x**6 == pytest.approx(4 * np.pi / 7, rel=1e-14)
    assert weight @ (x**3 * y * z**2) == pytest.approx(0, abs=1e-15)
    assert weight.sum() == pytest.approx(4 * np.pi, rel=1e-14)


def test_squares_of_a_band_sum_to_unsolds_constant(directions):
    squares = np.asarray(evaluate(directions, 30)) ** 2
    for band in range(30):
        np.testing.assert_allclose(
            squares[:, bands(30) == band].sum(axis=1), (2 * band + 1) / (4 * np.pi), rtol=1e-11, err_msg=str(band)
        )


def test_the_addition_theorem(directions):
    """Σ_m y_lm(a) y_lm(b) = (2l + 1)/4π P_l(a · b)."""
    first, second = np.asarray(evaluate(directions, 8)), np.asarray(evaluate(directions[::-1], 8))
    cosine = np.sum(directions * directions[::-1], axis=1)
    for band in range(8):
        legendre = np.polynomial.legendre.legval(cosine, np.eye(8)[band])
        found = np.sum((first * second)[:, bands(8) == band], axis=1)
        np.testing.assert_allclose(found, (2 * band + 1) / (4 * np.pi) * legendre, atol=1e-13)


@pytest.mark.parametrize("order", [6, 15])
def test_gradients_are_differences_at_the_poles_and_elsewhere(directions, order):
    """Along tangents, where harmonics have a meaning off the point: against differences on the sphere."""
    rng = np.random.default_rng(2)
    tangent = np.cross(directions, rng.normal(size=directions.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    found = jax.jvp(lambda d: evaluate(d, order), (jnp.asarray(directions),), (jnp.asarray(tangent),))[1]

    def difference(step):
        ahead, behind = (np.cos(step) * directions + sign * np.sin(step) * tangent for sign in (1, -1))
        return (np.asarray(evaluate(ahead, order)) - np.asarray(evaluate(behind, order))) / (2 * step)

    wanted = (4 * difference(1e-4) - difference(2e-4)) / 3
    np.testing.assert_allclose(found, wanted, atol=1e-7 * order**2)


def test_reverse_mode_is_finite_at_the_poles():
    for dtype in (np.float32, np.float64):
        pole = jnp.asarray([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], dtype)
        slope = jax.grad(lambda d: jnp.sum(evaluate(d, 30)))(pole)
        assert bool(jnp.all(jnp.isfinite(slope)))
    # y₁₁ = a x and y₂₁ = b x z: what spherical angles cannot tell at the pole
    at_pole = jax.jacrev(lambda d: evaluate(d, 3))(jnp.array([0.0, 0.0, 1.0]))
    assert float(at_pole[3, 0]) == pytest.approx(np.sqrt(3 / (4 * np.pi)))
    assert float(at_pole[7, 0]) == pytest.approx(np.sqrt(15 / (4 * np.pi)))


def test_parity(directions):
    """y_l(−ω) = (−1)^l y_l(ω), bit for bit."""
    np.testing.assert_array_equal(evaluate(-directions, 20), np.asarray(evaluate(directions, 20)) * (-1.0) ** bands(20))


def test_indices():
    assert bands(3).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]
    assert azimuths(3).tolist() == [0, -1, 0, 1, -2, -1, 0, 1, 2]
    assert [order_of(count(order)) for order in (1, 2, 5, 40)] == [1, 2, 5, 40]
    assert evaluate(np.array([[0, 0, 1]]), 2).dtype == jnp.float64
    assert evaluate(np.zeros((4, 5, 3)), 3).shape == (4, 5, 9)


@pytest.mark.parametrize("coefficients", [-1, 0, 3, 24])
def test_what_is_no_square_is_refused(coefficients):
    with pytest.raises(SpecError, match=f"{coefficients} is no number of spherical-harmonic coefficients"):
        order_of(coefficients)


def test_an_order_below_one_is_refused():
    with pytest.raises(SpecError, match="order is 0"):
        evaluate(np.eye(3), 0)
