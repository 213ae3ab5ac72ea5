"""The operator against dense linear algebra, energy bounds and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import FitError
from prt_bench.transport import GatherOperator, final_gather, indirect, radiosity, tail_bounds

S, R, N, C = 30, 8, 3, 2
RNG = np.random.default_rng(0)
HITS = RNG.integers(0, S + 4, (S, R)).clip(0, S + 1)  # S: carries nothing, S + 1: escaped
ALBEDO = RNG.uniform(0.1, 0.8, (S, C))
DIRECT = RNG.random((N, S, C))


def dense(hits: np.ndarray) -> np.ndarray:
    matrix = np.zeros((len(hits), S + 2))
    for row, entries in enumerate(hits):
        np.add.at(matrix[row], entries, 1.0 / hits.shape[1])
    return matrix[:, :S]


def test_gather_is_the_matrix_it_stands_for() -> None:
    light = RNG.random((S, 5))
    np.testing.assert_allclose(GatherOperator.from_hits(HITS, S)(light), dense(HITS) @ light, rtol=1e-12)


@pytest.mark.parametrize("differentiable", [False, True])
def test_adjoint_is_the_transposed_matrix(differentiable: bool) -> None:
    gather = GatherOperator.from_hits(HITS, S, differentiable)
    cotangent = RNG.random((S, 5))
    (pulled,) = jax.vjp(gather, jnp.zeros((S, 5)))[1](jnp.asarray(cotangent))
    np.testing.assert_allclose(pulled, dense(HITS).T @ cotangent, rtol=1e-12, atol=1e-15)


def test_all_bounces_solve_the_rendering_equation() -> None:
    gather = GatherOperator.from_hits(HITS, S)
    found = indirect(gather, jnp.asarray(ALBEDO), jnp.asarray(DIRECT), 400)
    matrix = dense(HITS)
    for channel in range(C):
        operator = matrix * ALBEDO[:, channel]
        exact = np.linalg.solve(np.eye(S) - operator, operator @ DIRECT[:, :, channel].T).T
        np.testing.assert_allclose(found[:, :, channel], exact, rtol=1e-10)


def test_bounces_count_from_the_first_gather() -> None:
    gather, albedo, direct = GatherOperator.from_hits(HITS, S), jnp.asarray(ALBEDO), jnp.asarray(DIRECT)
    one = np.moveaxis(
        np.stack([dense(HITS) * ALBEDO[:, c] @ DIRECT[:, :, c].T for c in range(C)]), (0, 1, 2), (2, 1, 0)
    )
    np.testing.assert_allclose(indirect(gather, albedo, direct, 1), one, rtol=1e-12)
    outgoing = radiosity(gather, albedo, direct, 0)
    np.testing.assert_allclose(final_gather(gather, outgoing), one, rtol=1e-12)


def test_no_gain_of_energy() -> None:
    gather = GatherOperator.from_hits(HITS, S)
    light = indirect(gather, jnp.asarray(ALBEDO), jnp.asarray(DIRECT), 200)
    bound = ALBEDO.max() / (1 - ALBEDO.max()) * DIRECT.max()
    assert 0 <= float(light.min()) <= float(light.max()) <= bound


def test_light_adds_up() -> None:
    gather, albedo = GatherOperator.from_hits(HITS, S), jnp.asarray(ALBEDO)
    both = indirect(gather, albedo, jnp.asarray(DIRECT[:1] + 3.0 * DIRECT[1:2]), 20)
    apart = indirect(gather, albedo, jnp.asarray(DIRECT), 20)
    np.testing.assert_allclose(both[0], apart[0] + 3.0 * apart[1], rtol=1e-12)


def test_tail_bounds_hold_and_shrink() -> None:
    gather = GatherOperator.from_hits(HITS, S)
    albedo = jnp.asarray(ALBEDO)
    bounds = tail_bounds(gather, albedo, 30)
    direct = jnp.ones((1, S, C))
    everything = np.asarray(indirect(gather, albedo, direct, 400))
    for bounces in (1, 2, 5, 12, 29):
        missing = (everything - np.asarray(indirect(gather, albedo, direct, bounces))).max()
        assert missing <= bounds[bounces - 1] * (1 + 1e-9)
    assert np.all(np.diff(bounds) < 0)
    assert len(bounds) == 30


def test_light_that_dies_out_has_a_last_bound_of_zero() -> None:
    chain = np.arange(1, 5)[:, None]  # sample i sees sample i + 1, the last sees nothing
    bounds = tail_bounds(GatherOperator.from_hits(chain, 4), jnp.ones((4, 1)), 30)
    np.testing.assert_array_equal(bounds, [2.0, 1.0, 0.0, 0.0])


def test_closed_scene_of_albedo_one_is_refused() -> None:
    hits = RNG.integers(0, S, (S, R))
    with pytest.raises(FitError, match="does not decay"):
        tail_bounds(GatherOperator.from_hits(hits, S), jnp.ones((S, 1)), 50)


def test_hits_beyond_the_samples_are_refused() -> None:
    with pytest.raises(FitError, match="does not index"):
        GatherOperator.from_hits(HITS + 1, S)


@pytest.mark.parametrize("differentiable", [False, True])
def test_gradients_to_albedo_and_light_match_finite_differences(differentiable: bool) -> None:
    gather = GatherOperator.from_hits(HITS, S, differentiable)
    weight = jnp.asarray(RNG.random((N, S, C)))

    @jax.jit
    def loss(albedo: jax.Array, direct: jax.Array) -> jax.Array:
        return jnp.sum(weight * indirect(gather, albedo, direct, 12))

    at = (jnp.asarray(ALBEDO), jnp.asarray(DIRECT))
    gradients = jax.grad(loss, argnums=(0, 1))(*at)
    for argument, gradient in enumerate(gradients):
        for _ in range(6):
            index = tuple(RNG.integers(0, n) for n in gradient.shape)
            ends = []
            for sign in (1, -1):
                moved = list(at)
                moved[argument] = moved[argument].at[index].add(sign * 1e-5)
                ends.append(float(loss(*moved)))
            assert float(gradient[index]) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-6)
