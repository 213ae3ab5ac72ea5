"""Triple products: against an independent quadrature and Gaunt's closed form, sparsity, and products of functions."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import SpecError
from prt_bench.spherical import (
    dense_operations,
    evaluate,
    product,
    product_matrix,
    quadrature,
    reconstruct,
    sparse_operations,
    triple_products,
)


def whole(order):
    found = triple_products(order)
    tensor = np.zeros([order**2] * 3)
    tensor[tuple(found.indices.T)] = found.values
    return tensor


@pytest.mark.parametrize("order", range(1, 6))
def test_every_entry_is_the_integral_and_no_other_is_left_out(order, oracle):
    """scipy's harmonics, and more points than are needed."""
    points, weight = quadrature(3 * order + 8)
    harmonics = oracle(points, order)
    wanted = np.einsum("q,qi,qj,qk->ijk", weight, harmonics, harmonics, harmonics, optimize=True)
    np.testing.assert_allclose(whole(order), wanted, atol=1e-13)
    assert np.sum(np.abs(wanted) > 1e-10) == sparse_operations(order)


def wigner_zero(a, b, c):
    """(a b c; 0 0 0), by the closed form for an even sum."""
    if (a + b + c) % 2 or not abs(a - b) <= c <= a + b:
        return 0.0
    s = (a + b + c) // 2
    root = factorial(2 * s - 2 * a) * factorial(2 * s - 2 * b) * factorial(2 * s - 2 * c) / factorial(2 * s + 1)
    return (-1) ** s * np.sqrt(root) * factorial(s) / factorial(s - a) / factorial(s - b) / factorial(s - c)


def test_zonal_entries_are_gaunts():
    """∫ y_a0 y_b0 y_c0 = √((2a+1)(2b+1)(2c+1)/4π) (a b c; 0 0 0)²."""
    tensor = whole(6)
    for a, b, c in np.ndindex(6, 6, 6):
        size = np.sqrt((2 * a + 1) * (2 * b + 1) * (2 * c + 1) / (4 * np.pi))
        assert tensor[a * (a + 1), b * (b + 1), c * (c + 1)] == pytest.approx(
            size * wigner_zero(a, b, c) ** 2, abs=1e-14
        )


def test_the_tensor_is_symmetric_and_sparse():
    counts = {order: sparse_operations(order) for order in range(1, 7)}
    assert counts == {1: 1, 2: 10, 3: 83, 4: 353, 5: 1158, 6: 2907}
    assert all(counts[order] <= dense_operations(order) / 5 for order in range(2, 7))
    assert sparse_operations(10) <= dense_operations(10) / 20
    tensor = whole(5)
    for turn in ((1, 0, 2), (0, 2, 1), (2, 1, 0)):
        np.testing.assert_array_equal(tensor, tensor.transpose(turn))
    indices = triple_products(5).indices
    assert len(np.unique(indices, axis=0)) == len(indices)


def test_times_one_is_the_function_itself():
    one = np.zeros(25)
    one[0] = np.sqrt(4 * np.pi)
    function = np.random.default_rng(0).normal(size=25)
    np.testing.assert_allclose(product(one, function), function, atol=1e-14)
    np.testing.assert_allclose(product_matrix(one), np.eye(25), atol=1e-14)


def test_products_of_low_order_are_exact(directions):
    """Two functions of order 3 have a product of order 5, which is theirs at every direction."""
    rng = np.random.default_rng(1)
    a, b = np.zeros((2, 25))
    a[:9], b[:9] = rng.normal(size=(2, 9))
    wanted = (np.asarray(evaluate(directions, 5)) @ a) * (np.asarray(evaluate(directions, 5)) @ b)
    np.testing.assert_allclose(reconstruct(product(a, b)[:, None], directions)[:, 0], wanted, atol=1e-13)


def test_products_are_the_projection_of_what_is_cut_off():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 25))
    points, weight = quadrature(16)
    harmonics = np.asarray(evaluate(points, 5))
    wanted = harmonics.T @ (weight * (harmonics @ a) * (harmonics @ b))
    np.testing.assert_allclose(product(a, b), wanted, atol=1e-13)
    np.testing.assert_allclose(product(b, a), wanted, atol=1e-13)
    np.testing.assert_allclose(product_matrix(a) @ b, wanted, atol=1e-13)
    np.testing.assert_array_equal(product_matrix(a), product_matrix(a).T)


def test_products_broadcast_and_differentiate():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(6, 1, 9)), rng.normal(size=(4, 9)).astype(np.float32)
    found = product(a, b)
    assert found.shape == (6, 4, 9)
    np.testing.assert_allclose(found[2, 3], product(a[2, 0], b[3]), atol=1e-14)
    assert product_matrix(a).shape == (6, 1, 9, 9)
    assert product(b, b).dtype == jnp.float32
    slope = jax.jacfwd(lambda f: product(f, jnp.asarray(a[0, 0])))(jnp.asarray(a[1, 0]))
    np.testing.assert_allclose(slope, product_matrix(a[0, 0]), atol=1e-13)


def test_functions_of_different_order_are_refused():
    with pytest.raises(SpecError, match="9 and 4 coefficients"):
        product(np.ones(9), np.ones(4))
