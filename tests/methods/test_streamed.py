"""Methods that learn from streamed lightings: what they reduce to, and what makes them best."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.errors import DatasetError
from prt_bench.example import example_dataset
from prt_bench.methods.operator import fit_albedo, importance
from prt_bench.methods.reduced_rank import streamed_weights
from prt_bench.methods.streamed_ridge import streamed_examples

DATASET = example_dataset()
TRAIN, TEST = DATASET.split("train"), DATASET.split("test")
NAMES = ("streamed-ridge", "reduced-rank")


def streaming(direct, measured):
    return replace(DATASET, arrays={**DATASET.arrays, "streamed_direct": direct, "streamed_measured": measured})


@pytest.mark.parametrize("name", NAMES)
def test_without_streamed_lightings_it_says_what_to_do(name):
    arrays = {key: value for key, value in DATASET.arrays.items() if not key.startswith("streamed")}
    with pytest.raises(DatasetError, match="bake it with streamed"):
        prt.method(name).fit(replace(DATASET, arrays=arrays).split("train"))


def test_streamed_coefficients_are_those_of_baked_light():
    """Training lightings sent through the adjoint as if they were streamed, against their baked indirect light."""
    u = np.linalg.qr(np.random.default_rng(0).normal(size=(len(DATASET.points), 7)))[0]
    adjoint = importance(DATASET.transport, fit_albedo(DATASET), jnp.asarray(u))
    green = streaming(TRAIN.direct[..., 1], TRAIN.measured[..., 1])
    x, found = streamed_examples(green, adjoint)
    np.testing.assert_array_equal(x, TRAIN.measured[..., 1].T)
    np.testing.assert_allclose(found[1], u.T @ TRAIN.indirect[..., 1].T, atol=2e-5 * np.abs(found[1]).max())


def test_streaming_the_training_lightings_is_svd_ridge():
    """White light: the streamed copies are the training lightings themselves, one of them black."""
    direct, measured = TRAIN.direct[..., 0], TRAIN.measured[..., 0]
    ds = streaming(direct, measured)
    adjoint = importance(ds.transport, fit_albedo(ds), jnp.eye(len(ds.points)))
    lit = {
        "measured": np.repeat(measured[..., None], 3, axis=2),
        "indirect": np.einsum("cst,ns->ntc", adjoint, direct),
    }
    train = replace(ds.split("train"), arrays={**ds.arrays, **lit})
    rank = 3 * (len(TRAIN) - 1)
    streamed = prt.method("streamed-ridge", basis=rank, ridge=1e-3, prior=0.0).fit(train)
    plain = prt.method("svd-ridge", basis=rank, ridge=1e-3, mean=False, transfer="per-channel").fit(train)
    np.testing.assert_allclose(streamed.predict(TEST), plain.predict(TEST), rtol=1e-3, atol=1e-4)


def test_reduced_rank_has_the_least_error_of_its_rank():
    """Its expected error under the streamed lightings against other maps of the same rank from the same examples."""
    weight = streamed_weights(DATASET, fit_albedo(DATASET))[:, None]
    x, direct = DATASET.streamed.measured * weight, DATASET.arrays["streamed_direct"] * weight
    adjoint = np.asarray(importance(DATASET.transport, fit_albedo(DATASET), jnp.eye(len(DATASET.points))))
    light = np.einsum("cst,ns->ntc", adjoint, direct)

    def cost(model):
        coefficients = np.einsum("cbm,nm->nbc", np.asarray(model.weights)[:, :, :-1], x)
        predicted = np.einsum("tb,nbc->ntc", np.asarray(model.basis), coefficients)
        return float(np.sum((predicted - light) ** 2))

    models = {name: prt.method(name, basis=4, ridge=1e-9, prior=0.0).fit(TRAIN) for name in NAMES}
    best = cost(models["reduced-rank"])
    assert best < 0.999 * cost(models["streamed-ridge"])
    rng = np.random.default_rng(0)
    found = models["reduced-rank"]
    for _ in range(20):  # and no map near it is better
        moved = replace(
            found,
            basis=found.basis + 1e-3 * rng.normal(size=found.basis.shape),
            weights=found.weights * (1.0 + 1e-3 * rng.normal(size=found.weights.shape)),
        )
        assert cost(moved) > best


def test_reduced_rank_of_full_rank_is_the_ridge_regression():
    """Spelled out by normal equations on the streamed lightings, for all receivers at once."""
    weight = streamed_weights(DATASET, fit_albedo(DATASET))[:, None]
    x, direct = (light * weight for light in (DATASET.streamed.measured, DATASET.arrays["streamed_direct"]))
    adjoint = np.asarray(importance(DATASET.transport, fit_albedo(DATASET), jnp.eye(len(DATASET.points))), float)
    measurements = x.shape[1]
    model = prt.method("reduced-rank", basis=3 * measurements, ridge=1e-2, prior=0.0).fit(TRAIN)
    seen = x.T @ x
    inverse = np.linalg.inv(seen + 1e-2 * np.trace(seen) / measurements * np.eye(measurements))
    for c in range(3):
        expected = adjoint[c].T @ direct.T @ x @ inverse
        found = np.asarray(model.basis) @ np.asarray(model.weights)[c, :, :-1]
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_weights_are_one_over_the_size_of_the_indirect_light():
    adjoint = np.asarray(importance(DATASET.transport, fit_albedo(DATASET), jnp.eye(len(DATASET.points))), float)
    size = np.linalg.norm(np.einsum("cst,ns->nct", adjoint, DATASET.arrays["streamed_direct"]), axis=(1, 2))
    found = streamed_weights(DATASET, fit_albedo(DATASET)) * size
    assert np.sqrt(np.mean((found - 1.0) ** 2)) < 0.3


@pytest.mark.parametrize("name", NAMES)
def test_thousands_of_lightings_beat_the_training_lightings(name):
    ds = example_dataset(measurements=96, lightings=16)
    streamed, plain = (
        prt.evaluate(prt.method(method, basis=12).fit(ds.split("train")), ds.split("test")).errors.relative_rmse
        for method in (name, "svd-ridge")
    )
    assert streamed < 0.8 * plain


@pytest.mark.parametrize("encoding", ["frequency", "grid"])
def test_a_field_is_trained_far_beyond_its_random_features(encoding):
    """Few texels too get the steps that a field needs."""
    model = prt.method("mlp-decoder", basis=4, width=32, encoding=encoding).fit(TRAIN, jax.random.key(0))
    error = model.history["validation_error"]
    assert error.min() < 0.05 * error[0]
