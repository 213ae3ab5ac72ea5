"""Rotations: against turned directions, as a group, at every angle, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import SpecError
from prt_bench.hemisphere import tangent_frames
from prt_bench.spherical import apply, block_diagonal, evaluate, reconstruct, rotate, rotation_blocks


@pytest.mark.parametrize(("order", "tolerance"), [(1, 1e-15), (2, 1e-15), (5, 1e-14), (10, 1e-13)])
def test_turned_directions_have_turned_harmonics(rotations, directions, order, tolerance):
    """y(R ω) = D y(ω), of every block."""
    turned = evaluate(np.einsum("rij,dj->rdi", rotations, directions), order)
    whole = np.asarray(block_diagonal(rotation_blocks(rotations, order)))
    np.testing.assert_allclose(evaluate(directions, order) @ np.swapaxes(whole, 1, 2), turned, atol=tolerance)


@pytest.mark.parametrize(("dtype", "order", "tolerance"), [(np.float64, 10, 1e-12), (np.float32, 20, 1e-5)])
def test_blocks_are_orthogonal_and_multiply_as_rotations_do(rotations, dtype, order, tolerance):
    one, other = rotations.astype(dtype), rotations[::-1].astype(dtype)
    a, b, ab = (np.asarray(block_diagonal(rotation_blocks(r, order))) for r in (one, other, one @ other))
    assert a.dtype == dtype
    np.testing.assert_allclose(a @ b, ab, atol=tolerance)
    np.testing.assert_allclose(a @ np.swapaxes(a, 1, 2), np.broadcast_to(np.eye(order**2), a.shape), atol=tolerance)
    back = np.asarray(block_diagonal(rotation_blocks(np.swapaxes(one, 1, 2), order)))
    np.testing.assert_allclose(back, np.swapaxes(a, 1, 2), atol=tolerance)


def test_float32_blocks_are_those_of_float64(rotations):
    single = rotations.astype(np.float32)
    found, wanted = (block_diagonal(rotation_blocks(r, 20)) for r in (single, single.astype(float)))
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_the_identity_is_exact():
    for dtype in (np.float32, np.float64):
        for block in rotation_blocks(np.eye(3, dtype=dtype), 10):
            np.testing.assert_allclose(block, np.eye(len(block)), atol=4 * np.finfo(dtype).eps)


def test_a_turn_about_z_mixes_m_with_minus_m_alone():
    """cos and sin of mα, the one closed form that every band has."""
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    block = np.asarray(rotation_blocks(turn, 5)[4])
    m = np.arange(-4, 5)
    np.testing.assert_allclose(np.diagonal(block), np.cos(m * angle), atol=1e-14)
    np.testing.assert_allclose(np.diagonal(np.fliplr(block)), np.where(m == 0, 1, np.sin(-m * angle)), atol=1e-14)


def test_reflections_are_handled(directions):
    mirror = np.diag([1.0, -1.0, 1.0])
    whole = block_diagonal(rotation_blocks(mirror, 6))
    np.testing.assert_allclose(whole @ evaluate(directions, 6).T, evaluate(directions @ mirror, 6).T, atol=1e-14)
    np.testing.assert_allclose(
        block_diagonal(rotation_blocks(-np.eye(3), 3)), np.diag([1.0, *[-1.0] * 3, *[1.0] * 5]), atol=1e-15
    )


def test_a_rotated_function_has_its_old_values_at_turned_directions(rotations, directions):
    """f′(R ω) = f(ω), one rotation per vector, with axes behind the coefficients."""
    rng = np.random.default_rng(3)
    coefficients = rng.normal(size=(len(rotations), 25, 3))
    turned = rotate(coefficients, rotations)
    for before, after, rotation in zip(coefficients, turned, rotations, strict=True):
        np.testing.assert_allclose(
            reconstruct(after, directions @ rotation.T), reconstruct(before, directions), atol=1e-12
        )
    np.testing.assert_allclose(apply(rotation_blocks(rotations, 5), jnp.asarray(coefficients)), turned, atol=1e-14)
    np.testing.assert_allclose(rotate(coefficients[0], rotations[0]), turned[0], atol=1e-14)


def test_a_local_frame_comes_to_the_world_by_its_transpose():
    """Frames hold rows (tangent, bitangent, normal): a lobe about local z becomes one about the normal."""
    normal = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    frames = tangent_frames(normal, np.array([0.3, 1.0, 2.0]))
    lobe = np.tile(np.asarray(evaluate(np.array([0.0, 0.0, 1.0]), 5)), (3, 1))
    np.testing.assert_allclose(rotate(lobe, np.swapaxes(frames, 1, 2)), evaluate(normal, 5), atol=1e-14)


def test_groups_of_rotations_do_not_show(monkeypatch):
    rng = np.random.default_rng(4)
    coefficients, rotations = rng.normal(size=(70, 9)), np.linalg.qr(rng.normal(size=(70, 3, 3)))[0]
    whole = apply(rotation_blocks(rotations, 3), jnp.asarray(coefficients))
    monkeypatch.setattr("prt_bench.spherical.rotation._GROUP", 32)
    jax.clear_caches()
    np.testing.assert_allclose(rotate(coefficients, rotations), whole, atol=1e-14)
    jax.clear_caches()


def test_many_rotations_are_differentiable(rotations):
    """The adjoint of a rotation is its inverse; the derivative in the matrices is finite."""
    values = jnp.asarray(np.random.default_rng(5).normal(size=(len(rotations), 9)))
    loss = jax.grad(lambda v, r: 0.5 * jnp.sum(rotate(v, r) ** 2 + v * rotate(v, r)), argnums=(0, 1))
    by_values, by_rotations = loss(values, jnp.asarray(rotations))
    wanted = values + 0.5 * (rotate(values, rotations) + rotate(values, np.swapaxes(rotations, 1, 2)))
    np.testing.assert_allclose(by_values, wanted, atol=1e-13)
    assert bool(jnp.all(jnp.isfinite(by_rotations)))


def test_the_derivative_is_that_of_the_group_everywhere(rotations):
    """d/dt D(exp(t A) R) = (d/dt D(exp(t A))) D(R): locked angles and half turns have no singularity."""
    generator = np.array([[0.0, -0.3, 0.5], [0.3, 0.0, -0.7], [-0.5, 0.7, 0.0]])

    def moved(matrix):
        slope = jnp.asarray(np.broadcast_to(generator, matrix.shape) @ matrix)
        return jax.jvp(lambda r: block_diagonal(rotation_blocks(r, 6)), (jnp.asarray(matrix),), (slope,))[1]

    at_identity = np.asarray(moved(np.eye(3)))
    np.testing.assert_allclose(
        moved(rotations), at_identity @ np.asarray(block_diagonal(rotation_blocks(rotations, 6))), atol=1e-12
    )
    step = 1e-4
    turn = jax.scipy.linalg.expm(jnp.asarray(step * generator))
    forth, back = (np.asarray(block_diagonal(rotation_blocks(r, 6))) for r in (turn, turn.T))
    np.testing.assert_allclose(at_identity, (forth - back) / (2 * step), atol=1e-6)


def test_wrong_shapes_are_refused():
    with pytest.raises(SpecError, match="must end in"):
        rotation_blocks(np.eye(4), 3)
    with pytest.raises(SpecError, match="axis 0 must hold 9"):
        apply(rotation_blocks(np.eye(3), 3), jnp.zeros(4))
