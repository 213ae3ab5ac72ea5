"""The operator as a prior: its adjoint, its limits, and what it is for."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.example import example_dataset
from prt_bench.linalg import leading_basis
from prt_bench.methods import operator_ridge
from prt_bench.methods.examples import Examples, normalised
from prt_bench.methods.operator_ridge import Cells, cells, importance, regress_with_cells

DATASET = example_dataset()
TRAIN, TEST = DATASET.split("train"), DATASET.split("test")


def test_importance_is_the_adjoint_of_the_bake(monkeypatch):
    """⟨𝒮ᵀ U, E⟩ = ⟨U, 𝒮 E⟩ for the direct and indirect light that were baked, in every channel and chunk of receivers."""
    monkeypatch.setattr(operator_ridge, "_RECEIVERS", 50)
    u = np.random.default_rng(0).normal(size=(len(DATASET.points), 5))
    adjoint = importance(DATASET.transport, jnp.asarray(DATASET.transport.samples.albedo, jnp.float32), jnp.asarray(u))
    found = np.einsum("csb,nsc->nbc", adjoint, TEST.direct)
    expected = np.einsum("tb,ntc->nbc", u, TEST.indirect)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_cells_split_the_samples_by_nearness_and_facing():
    found = cells(DATASET)
    points, samples = DATASET.measurement_points, DATASET.transport.samples
    assert found.of_sample.shape == (len(samples),)
    np.testing.assert_allclose(np.sum(points.normal[found.of_sample] * samples.normal, axis=1), 1.0)
    np.testing.assert_allclose(found.measured.sum(axis=1), 1.0)
    np.testing.assert_allclose(found.measured, np.eye(len(points)))  # one dense point each, its own cell


def test_without_the_prior_it_is_svd_ridge_without_its_mean():
    bare = prt.method("operator-ridge", prior=0.0, ridge=1e-3, basis=8).fit(TRAIN)
    same = prt.method("svd-ridge", mean=False, transfer="per-channel", ridge=1e-3, basis=8).fit(TRAIN)
    np.testing.assert_allclose(bare.predict(TEST), same.predict(TEST), rtol=1e-8)


def test_the_matrix_is_the_estimate_under_the_mixed_covariance():
    """u = Uᵀ 𝒮 Σ Aᵀ (A Σ Aᵀ + λ)⁻¹ x, spelled out for one channel with both covariances of trace 1."""
    rng = np.random.default_rng(0)
    x, y, adjoint = rng.uniform(size=(6, 30)), rng.uniform(size=(11, 30)), rng.normal(size=(1, 20, 4))
    u, measured, of_sample = np.linalg.qr(rng.normal(size=(11, 4)))[0], rng.uniform(size=(6, 6)), rng.integers(0, 6, 20)
    examples = Examples(*(jnp.asarray(a) for a in (x, y, np.linalg.norm(x, axis=0), 0.0)))
    found = regress_with_cells(examples, jnp.asarray(u), Cells(of_sample, measured), jnp.asarray(adjoint), 0.02, 0.3)

    light, cell_trace = np.sum(x**2), np.sum(measured**2)
    response = adjoint[0].T @ np.eye(6)[of_sample]
    seen = 0.7 * x @ x.T / light + 0.3 * measured @ measured.T / cell_trace
    caused = 0.7 * u.T @ y @ x.T / light + 0.3 * response @ measured.T / cell_trace
    np.testing.assert_allclose(found[0], caused @ np.linalg.inv(seen + 0.02 / 6 * np.eye(6)), rtol=1e-10)


def test_light_that_is_constant_on_cells_is_predicted_whatever_the_lightings():
    """With the prior alone, x = E on cells goes to the projection of 𝒮 E on the basis."""
    model = prt.method("operator-ridge", prior=1.0, ridge=1e-12, basis=12).fit(TRAIN)
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (4, len(DATASET.measurement_points), 3))
    direct = x[:, cells(DATASET).of_sample]
    adjoint = importance(DATASET.transport, jnp.asarray(DATASET.transport.samples.albedo, jnp.float32), model.basis)
    expected = np.einsum("csb,nsc->nbc", adjoint, direct)
    np.testing.assert_allclose(model.transfer(jnp.asarray(x)), expected, rtol=1e-4)


def test_it_is_additive():
    model, x = prt.method("operator-ridge").fit(TRAIN), jnp.asarray(TEST.measured, jnp.float64)
    np.testing.assert_allclose(
        model.transfer(x[:1] + x[1:2]), model.transfer(x[:1]) + model.transfer(x[1:2]), rtol=1e-10
    )


def test_it_beats_svd_ridge_on_lights_never_seen():
    """At the same size and so the same run-time cost, with the same span."""
    ds = example_dataset(measurements=96)
    prior, plain = (
        prt.evaluate(prt.method(name, basis=16).fit(ds.split("train")), ds.split("test")).errors
        for name in ("operator-ridge", "svd-ridge")
    )
    assert prior.relative_rmse < 0.6 * plain.relative_rmse
    assert prior.projection == pytest.approx(plain.projection, rel=0.1)


def test_one_channel_serves_an_achromatic_room():
    materials = tuple(replace(material, albedo=(0.5, 0.5, 0.5)) for material in DATASET.scene.materials)
    grey = replace(DATASET, transport=replace(DATASET.transport, scene=replace(DATASET.scene, materials=materials)))
    assert prt.method("operator-ridge").fit(grey.split("train")).weights.shape[0] == 1
    assert prt.method("operator-ridge").fit(TRAIN).weights.shape[0] == 3


def test_the_basis_is_that_of_the_training_light():
    model = prt.method("operator-ridge", basis=6).fit(TRAIN)
    u, _ = leading_basis(normalised(TRAIN.measured, TRAIN.indirect).y, 6, 0.0)
    np.testing.assert_allclose(model.basis @ model.basis.T, u @ u.T, atol=1e-5)
