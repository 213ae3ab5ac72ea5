"""Losses against their formulas where the light is usual, and finite with finite slopes where it is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.learned.losses import FLOOR, power_of_two, relative_square


def test_a_relative_loss_weighs_a_tenth_the_same_in_light_and_in_shade():
    target = jnp.array([1.0, 0.2])
    for scale in (1.1, 0.9):
        each = [float(relative_square(scale * t, t)) for t in target[:, None]]
        assert each[0] == pytest.approx(each[1], rel=1e-6)
    np.testing.assert_allclose(relative_square(jnp.array([0.5]), jnp.array([1.0])), 0.25, rtol=1e-6)
    np.testing.assert_allclose(relative_square(jnp.array([0.01]), jnp.array([0.0])), 0.01**2 / FLOOR**2, rtol=1e-6)


def test_the_denominator_is_constant_in_the_derivative():
    """∂/∂p of (p − t)² / m² with m held: 2 (p − t) / m²."""
    p, t = 0.7, 0.3
    slope = jax.grad(lambda p: relative_square(p[None], jnp.array([t])))(jnp.asarray(p))
    assert float(slope) == pytest.approx(2 * (p - t) / p**2, rel=1e-6)


def test_darkness_has_finite_loss_and_slope():
    dark = jnp.zeros(4)
    for size in (1.0, 0.0):
        value, slope = jax.value_and_grad(lambda p, size=size: relative_square(p, dark, size))(dark)
        assert bool(jnp.isfinite(value) & jnp.all(jnp.isfinite(slope)))


@pytest.mark.parametrize("size", [1e-300, 3.7e-6, 1.0, 1.5, 2.0, 1e20, 1e300])
def test_powers_of_two_lie_below_by_less_than_two_and_change_no_digit(size):
    found = float(power_of_two(size))
    assert np.frexp(found)[0] == 0.5
    assert found <= size < 2 * found
    digits = np.random.default_rng(0).normal(size=9)
    np.testing.assert_array_equal(digits * found / found, digits)


@pytest.mark.parametrize("size", [0.0, np.inf, np.nan])
def test_what_has_no_size_is_not_scaled(size):
    assert float(power_of_two(size)) == 1.0
