"""Zonal factors against quadrature, their limits and derivatives; windows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

from prt_bench.errors import SpecError
from prt_bench.spherical import (
    bands,
    cap_lobe,
    cap_solid_angle,
    convolve,
    cosine_lobe,
    delta_light,
    evaluate,
    hann,
    lanczos,
    phong_lobe,
    positive,
    quadrature,
    reconstruct,
    zonal_factors,
)


def by_scipy(function, order, low=0.0, high=1.0):
    return np.array(
        [2 * np.pi * quad(lambda t, n=n: function(t) * eval_legendre(n, t), low, high)[0] for n in range(order)]
    )


def test_the_cosine_lobe_is_that_of_the_literature():
    wanted = [np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24, 0, np.pi / 64]
    np.testing.assert_allclose(cosine_lobe(7), wanted, atol=1e-15)
    np.testing.assert_allclose(cosine_lobe(12), by_scipy(lambda t: t, 12), atol=1e-10)
    assert cosine_lobe(1).tolist() == [np.pi]


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 2, 2.7, 8, 13.2, 200])
def test_phong_factors_are_the_integrals(exponent):
    """Bands beyond s + 2 too, where the sign changes."""
    found = phong_lobe(exponent, 12)
    np.testing.assert_allclose(found, by_scipy(lambda t: (exponent + 1) / (2 * np.pi) * t**exponent, 12), atol=1e-8)
    assert float(jnp.abs(found).max()) == 1.0


def test_phong_at_its_extremes():
    """The hemisphere, the cosine, the mirror, and float32 next to the mirror."""
    np.testing.assert_allclose(phong_lobe(0.0, 5), [1, 0.5, 0, -0.125, 0], atol=1e-16)
    np.testing.assert_allclose(phong_lobe(1.0, 9), cosine_lobe(9) / np.pi, atol=1e-15)
    np.testing.assert_array_equal(phong_lobe(np.inf, 9), np.ones(9))
    sharp = phong_lobe(np.float32(1e6), 9)
    band = np.arange(9)
    np.testing.assert_allclose(sharp, np.exp(-band * (band + 1) / 2 / 1e6), rtol=3e-7)
    assert phong_lobe(np.array([1.0, 2.0]), 4).shape == (2, 4)


@pytest.mark.parametrize("exponent", [0.0, 0.7, 3.0, 1e6, np.inf])
def test_phong_has_a_derivative_in_its_exponent(exponent):
    slope = jax.jacfwd(lambda s: phong_lobe(s, 9))(jnp.asarray(exponent))
    back = jax.jacrev(lambda s: phong_lobe(s, 9))(jnp.asarray(exponent))
    np.testing.assert_allclose(slope, back, atol=1e-14)
    if np.isinf(exponent):
        np.testing.assert_array_equal(slope, np.zeros(9))
    else:
        step = 1e-4 * (1 + exponent)
        wanted = (np.asarray(phong_lobe(exponent + step, 9)) - np.asarray(phong_lobe(exponent - step, 9))) / (2 * step)
        np.testing.assert_allclose(slope, wanted, rtol=1e-5, atol=1e-6 * float(np.abs(wanted).max()))


@pytest.mark.parametrize("angle", [0.05, 0.6, np.pi / 2, 2.5, np.pi])
def test_caps_are_the_integrals(angle):
    found = np.asarray(cap_lobe(angle, 10)) * float(cap_solid_angle(angle))
    np.testing.assert_allclose(found, by_scipy(np.ones_like, 10, np.cos(angle)), atol=1e-11)


def test_small_caps_keep_their_digits():
    """The sun's disc in float32, against the series 1 − l (l + 1) α²/8; a point has no size, and a derivative."""
    angle, band = np.float32(0.00465), np.arange(10)
    series = 1 - band * (band + 1) * float(angle) ** 2 / 8
    np.testing.assert_allclose(cap_lobe(angle, 10), series, rtol=3e-7)
    assert float(cap_solid_angle(angle)) == pytest.approx(
        np.pi * float(angle) ** 2 * (1 - float(angle) ** 2 / 12), rel=3e-7
    )
    np.testing.assert_array_equal(cap_lobe(0.0, 10), np.ones(10))
    assert bool(jnp.all(jnp.isfinite(jax.jacrev(lambda a: cap_lobe(a, 10))(jnp.asarray(0.0)))))
    np.testing.assert_allclose(cap_lobe(np.pi, 10), np.eye(10)[0], atol=1e-14)


def test_convolution_is_the_integral_over_the_sphere(directions):
    """Irradiance of a random radiance, against ∫ L(ω) max(n · ω, 0) dω by brute force."""
    rng = np.random.default_rng(0)
    coefficients = rng.normal(size=(25, 1))
    points, weight = quadrature(400)
    radiance = np.asarray(reconstruct(coefficients, points))[:, 0] * weight
    wanted = np.maximum(directions @ points.T, 0.0) @ radiance
    found = reconstruct(convolve(coefficients, cosine_lobe(5), axis=0), directions)[:, 0]
    np.testing.assert_allclose(found, wanted, atol=1e-3 * np.abs(wanted).max())


def test_convolution_checks_and_broadcasts():
    values = np.random.default_rng(0).normal(size=(4, 3, 9))
    factors = np.random.default_rng(1).normal(size=(4, 1, 3))
    np.testing.assert_allclose(convolve(values, factors), values * factors[..., bands(3)])
    assert convolve(values.astype(np.float32), factors).dtype == jnp.float32
    with pytest.raises(SpecError, match="3 factors for coefficients of 2 bands"):
        convolve(np.ones(4), np.ones(3))


def test_zonal_factors_of_a_harmonic_pick_its_band():
    found = zonal_factors(lambda t: eval_legendre(3, t), 6, 8)
    np.testing.assert_allclose(found, 4 * np.pi / 7 * np.eye(6)[3], atol=1e-14)


@pytest.mark.parametrize("window", [hann, lanczos, positive])
@pytest.mark.parametrize("order", [1, 2, 5, 12])
def test_windows_keep_the_mean_and_fade(window, order):
    factors = window(order)
    assert factors.shape == (order,)
    assert factors[0] == 1.0
    assert np.all(np.diff(factors) < 0)
    assert np.all(factors > 0)


@pytest.mark.parametrize("order", range(1, 13))
def test_under_the_positive_window_a_delta_light_is_nowhere_negative(directions, order):
    light = delta_light(np.array([0.48, 0.6, 0.64]), np.ones(1), order)
    plain, windowed = (
        np.asarray(reconstruct(convolve(light, factors, axis=0), quadrature(60)[0]))
        for factors in (np.ones(order), positive(order))
    )
    assert windowed.min() >= -1e-14
    if order > 1:
        assert plain.min() < -0.1 * plain.max()


@pytest.mark.parametrize("order", range(2, 9))
def test_no_positive_window_is_sharper(order):
    """The largest mean cosine of a positive kernel, by linear programming over samples of it."""
    from scipy.optimize import linprog

    t = np.cos(np.linspace(0, np.pi, 400))
    kernel = np.polynomial.legendre.legvander(t, order - 1) * (2 * np.arange(order) + 1)
    best = linprog(
        -np.eye(order)[1], A_ub=-kernel, b_ub=np.zeros(len(t)), A_eq=np.eye(order)[:1], b_eq=[1.0], bounds=(None, None)
    )
    assert positive(order)[1] == pytest.approx(-best.fun, abs=1e-3)
    assert positive(order)[1] <= -best.fun + 1e-9


def test_a_delta_light_rings_and_windows_quieten_it():
    """The undershoot at order 5 relative to the peak: −15 % plain, less under each window."""
    t = np.linspace(-1, 1, 2001)
    kernel = np.polynomial.legendre.legvander(t, 4) * (2 * np.arange(5) + 1)
    low = {name: (kernel @ w).min() / (kernel @ w).max() for name, w in
           {"none": np.ones(5), "lanczos": lanczos(5), "hann": hann(5), "positive": positive(5)}.items()}  # fmt: skip
    assert low["none"] < -0.1 < low["lanczos"] < low["hann"] < 0
    assert low["positive"] >= -1e-15
    assert float(evaluate(np.array([0.0, 0, 1]), 5) @ evaluate(np.array([0.0, 0, 1]), 5)) == pytest.approx(
        25 / 4 / np.pi
    )
