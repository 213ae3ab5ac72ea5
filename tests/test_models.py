"""Models as weights, whatever fitted them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import FitError
from prt_bench.models import CoupledModel, LinearModel, NearestModel, interleaved

RNG = np.random.default_rng(0)


def linear(channels=1):
    return LinearModel(jnp.asarray(RNG.normal(size=(9, 4))), jnp.asarray(RNG.normal(size=(channels, 4, 6))))


def test_linear_model_is_its_formula():
    model, x = linear(), RNG.normal(size=(2, 5, 3))
    for n in range(2):
        for c in range(3):
            u = model.weights[0] @ np.append(x[n, :, c], np.linalg.norm(x[n, :, c]))
            np.testing.assert_allclose(model.transfer(x)[n, :, c], u, atol=1e-13)
            np.testing.assert_allclose(model.reconstruct(model.transfer(x))[n, :, c], model.basis @ u, atol=1e-12)


def test_a_matrix_per_channel_acts_on_its_own_channel():
    model, x = linear(3), jnp.asarray(RNG.normal(size=(2, 5, 3)))
    for c in range(3):
        alone = LinearModel(model.basis, model.weights[c : c + 1]).transfer(x[..., c : c + 1])
        np.testing.assert_allclose(model.transfer(x)[..., c : c + 1], alone, atol=1e-13)


def test_a_matrix_per_channel_refuses_other_channels():
    with pytest.raises(FitError, match="3 channels, but the light has 1"):
        linear(3).transfer(jnp.ones((2, 5, 1)))


def test_coupled_model_is_its_formula():
    basis, weights, x = RNG.normal(size=(9, 3, 4)), RNG.normal(size=(4, 16)), RNG.normal(size=(2, 5, 3))
    model = CoupledModel(jnp.asarray(basis), jnp.asarray(weights))
    y = model.reconstruct(model.transfer(jnp.asarray(x)))
    for n in range(2):
        rgb_rgb = np.concatenate([x[n, m] for m in range(5)])
        u = weights @ np.append(rgb_rgb, np.linalg.norm(rgb_rgb))
        np.testing.assert_allclose(model.transfer(jnp.asarray(x))[n, :, 0], u, atol=1e-13)
        for c in range(3):
            np.testing.assert_allclose(y[n, :, c], basis[:, c] @ u, atol=1e-12)


def test_coupled_model_is_the_joined_one_taken_apart():
    joined = LinearModel(jnp.asarray(RNG.normal(size=(18, 4))), jnp.asarray(RNG.normal(size=(1, 4, 11))))
    x, coupled = RNG.normal(size=(3, 5, 2)), CoupledModel.of(joined, 2)
    u = joined.transfer(interleaved(jnp.asarray(x)))
    np.testing.assert_allclose(coupled.transfer(jnp.asarray(x)), u, atol=1e-13)
    np.testing.assert_allclose(interleaved(coupled.reconstruct(u)), joined.reconstruct(u), atol=1e-13)
    np.testing.assert_array_equal(coupled.span, joined.span)


@pytest.mark.parametrize("channels", [1, 2])
def test_coupled_channels_refuse_others(channels):
    model = CoupledModel(jnp.ones((9, 3, 4)), jnp.ones((4, 16)))
    with pytest.raises(FitError, match=f"couples 3 channels, but the light has {channels}"):
        model.transfer(jnp.ones((2, 5, channels)))


def test_nearest_recalls_its_own_directions_at_any_intensity():
    directions = np.linalg.qr(RNG.normal(size=(5, 3)))[0].T
    model = NearestModel(jnp.asarray(RNG.normal(size=(9, 3))), jnp.asarray(directions))
    x = jnp.asarray(np.moveaxis(directions * [[2.0], [1e-3], [70.0]], 0, 1)[None])
    np.testing.assert_allclose(model.reconstruct(model.transfer(x))[0], model.basis * jnp.asarray([2.0, 1e-3, 70.0]))


def test_stages_can_be_jitted_as_they_are():
    first, second, x = linear(), linear(), jnp.asarray(RNG.normal(size=(2, 5, 3)))
    for model in (first, second):
        np.testing.assert_allclose(jax.jit(model.transfer)(x), model.transfer(x), rtol=1e-12)
