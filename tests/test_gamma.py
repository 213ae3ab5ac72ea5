"""Gamma space: the curve against its limits and its inverse, and fits there that keep what linear fits keep."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.contract import CHECKS, example_dataset
from prt_bench.gamma import TOE, GammaCoupledModel, GammaLinearModel, curve, over, root_mean_square, uncurve
from prt_bench.metrics import relative_rmse
from prt_bench.models import LinearModel

DATASET = example_dataset()
FORMS = ("shared", "per-channel", "coupled")
VALUES = np.concatenate([-np.geomspace(1e-12, 1e4, 60), [0.0], np.geomspace(1e-12, 1e4, 60)])


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 3.0])
def test_round_trip(gamma):
    """C1: no value is lost, negative ones included."""
    np.testing.assert_allclose(uncurve(curve(VALUES, gamma), gamma), VALUES, rtol=1e-12)
    np.testing.assert_allclose(curve(-VALUES, gamma), -np.asarray(curve(VALUES, gamma)), rtol=1e-14)


@pytest.mark.parametrize("gamma", [1.8, 2.2])
def test_a_power_far_from_zero_and_a_line_at_zero(gamma):
    large, small = np.geomspace(100 * TOE, 1e4, 30), np.geomspace(1e-9, 1e-3, 30) * TOE
    below = 1 - np.asarray(curve(large, gamma)) / large ** (1 / gamma)
    np.testing.assert_allclose(below, (large / TOE) ** (-2 / gamma), rtol=1e-2)
    slope = TOE ** (1 / gamma - 1) / gamma
    np.testing.assert_allclose(curve(small, gamma), slope * small, rtol=1e-6)
    assert jax.grad(curve)(0.0, gamma) == pytest.approx(slope, rel=1e-12)
    assert jax.grad(uncurve)(0.0, gamma) == pytest.approx(1 / slope, rel=1e-12)


def test_slopes_match_differences():
    for function in (curve, uncurve):
        for value in (-3.0, -TOE, 0.0, 0.3 * TOE, 0.2, 7.0):
            step = 1e-4 * (abs(value) + TOE)
            difference = (function(value + step, 2.2) - function(value - step, 2.2)) / (2 * step)
            assert jax.grad(function)(value, 2.2) == pytest.approx(float(difference), rel=1e-6)


def test_black_light_has_size_zero_and_no_gradient():
    black = jnp.zeros((1, 5, 3))
    assert not over(black, root_mean_square(black)).any()
    assert not jax.grad(lambda x: jnp.sum(over(x, root_mean_square(x))))(black).any()


def test_the_model_is_its_formula():
    rng = np.random.default_rng(0)
    basis, weights, x = rng.normal(size=(9, 4)), rng.normal(size=(1, 4, 6)), rng.normal(size=(2, 5, 3))
    model = GammaLinearModel(jnp.asarray(basis), jnp.asarray(weights), jnp.array([2.2, TOE]))
    y = model.reconstruct(model.transfer(jnp.asarray(x)))
    for n, c in np.ndindex(2, 3):
        size = np.sqrt(np.mean(x[n, :, c] ** 2))
        g = np.asarray(curve(x[n, :, c] / size, 2.2))
        wanted = size * np.asarray(uncurve(basis @ weights[0] @ np.append(g, np.linalg.norm(g)), 2.2))
        np.testing.assert_allclose(y[n, :, c], wanted, rtol=1e-10)


@pytest.mark.parametrize(("transfer", "mean"), [("shared", True), ("per-channel", False), ("coupled", True)])
def test_twice_the_light_gives_twice_the_answer(transfer, mean):
    """C4: a mean scaled by the norm of the light instead of the gamma-corrected light would not."""
    train, test = DATASET.split("train"), DATASET.split("test")
    model = prt.method("svd-ridge", basis=8, gamma=2.2, transfer=transfer, mean=mean).fit(train)
    assert isinstance(model, GammaCoupledModel if transfer == "coupled" else GammaLinearModel)
    x = jnp.asarray(test.measured, jnp.float64)
    plain = np.asarray(model.reconstruct(model.transfer(x)))
    for factor in (1e-9, 0.3, 1e7):
        scaled = np.asarray(model.reconstruct(model.transfer(factor * x))) / factor
        np.testing.assert_allclose(scaled, plain, atol=1e-12 * np.abs(plain).max())


@pytest.mark.parametrize("holds", ["gradients", "ships", "fit gradient"])
def test_contract_in_gamma_space(holds):
    """With unlit measurement points, where a power would have no slope."""
    measured = DATASET.arrays["measured"].copy()
    measured[:, ::5] = 0.0
    shaded = replace(DATASET, arrays={**DATASET.arrays, "measured": measured})
    CHECKS[holds](prt.method("svd-ridge", basis=8, gamma=2.2, transfer="coupled"), shaded)


@pytest.mark.parametrize("transfer", FORMS)
def test_gamma_one_is_the_plain_model(transfer):
    train, test = DATASET.split("train"), DATASET.split("test")
    plain = prt.method("svd-ridge", basis=8, transfer=transfer).fit(train)
    same = prt.method("svd-ridge", basis=8, transfer=transfer, gamma=1.0).fit(train)
    np.testing.assert_array_equal(same.predict(test), plain.predict(test))
    almost = prt.method("svd-ridge", basis=8, transfer=transfer, gamma=1.0 + 1e-9).fit(train)
    np.testing.assert_allclose(almost.predict(test), plain.predict(test), atol=1e-4 * test.indirect.max())


def test_a_transport_that_is_linear_in_gamma_space_is_recovered():
    """Fitted and predicted along the same curve, over the same size: a linear fit is off by a tenth."""
    rng = np.random.default_rng(0)
    transport = rng.uniform(0, 0.3, (40, 12))

    def light(seed):
        x = np.random.default_rng(seed).exponential(size=(100, 12, 3)) * 10.0 ** rng.uniform(-3, 3, (100, 1, 3))
        size = root_mean_square(jnp.asarray(x))
        y = size * uncurve(jnp.einsum("tm,nmc->ntc", transport, curve(over(x, size), 2.2)), 2.2)
        return SimpleNamespace(measured=x, indirect=np.asarray(y))

    train, test = light(1), light(2)
    errors = {
        gamma: relative_rmse(
            np.asarray(
                prt.method("svd-ridge", basis=12, gamma=gamma, mean=False, ridge=1e-12).fit(train).predict(test)
            ),
            test.indirect,
        )
        for gamma in (1.0, 2.2)
    }
    assert errors[2.2] < 1e-5 < 0.05 < errors[1.0]


def test_dark_texels_gain_more_than_bright_ones_lose():
    """Fig. 6 of the paper: what gamma space is for."""
    train, test = DATASET.split("train"), DATASET.split("test")
    dark = test.indirect < 0.25 * test.indirect.max(axis=1, keepdims=True)

    def errors(gamma):
        found = (
            prt.method("svd-ridge", basis=4, gamma=gamma, transfer="per-channel", mean=False).fit(train).predict(test)
        )
        wrong = np.asarray(found) - test.indirect
        return np.sqrt(np.mean((wrong[dark] / test.indirect[dark]) ** 2)), np.sqrt(np.mean(wrong[~dark] ** 2))

    (dark_plain, bright_plain), (dark_gamma, bright_gamma) = errors(1.0), errors(2.2)
    assert dark_gamma < 0.7 * dark_plain
    assert bright_gamma < 1.5 * bright_plain


def test_a_plain_model_is_not_taken_for_one_in_gamma_space(tmp_path):
    train = DATASET.split("train")
    for settings in ({}, {"gamma": 2.2}, {"transfer": "coupled"}, {"transfer": "coupled", "gamma": 2.2}):
        model = prt.method("svd-ridge", basis=4, **settings).fit(train)
        assert type(model.export(tmp_path / "asset").model()) is type(model)
    assert isinstance(prt.method("svd-ridge", basis=4).fit(train), LinearModel)
