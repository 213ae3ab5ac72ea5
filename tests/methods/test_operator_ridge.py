"""The operator as a prior: its adjoint, its limits, and what it is for."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.example import example_dataset
from prt_bench.linalg import leading_basis, relative_damping, ridge
from prt_bench.methods import operator, operator_ridge
from prt_bench.methods.examples import normalised
from prt_bench.methods.operator import fit_albedo, importance, respond
from prt_bench.methods.prior import mixed, prior_columns
from prt_bench.records import Errors

DATASET = example_dataset()
TRAIN, TEST = DATASET.split("train"), DATASET.split("test")


def test_importance_is_the_adjoint_of_the_bake(monkeypatch):
    """⟨𝒮ᵀ U, E⟩ = ⟨U, 𝒮 E⟩ for the direct and indirect light that were baked, in every channel and chunk of receivers."""
    monkeypatch.setattr(operator, "_RECEIVERS", 50)
    u = np.random.default_rng(0).normal(size=(len(DATASET.points), 5))
    adjoint = importance(DATASET.transport, jnp.asarray(DATASET.transport.samples.albedo, jnp.float32), jnp.asarray(u))
    found = np.einsum("csb,nsc->nbc", adjoint, TEST.direct)
    expected = np.einsum("tb,ntc->nbc", u, TEST.indirect)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_operator_goes_forward_as_the_bake_does(monkeypatch):
    monkeypatch.setattr(operator, "_RECEIVERS", 50)
    monkeypatch.setattr(operator, "_COLUMNS", 5)
    albedo = fit_albedo(DATASET)
    found = respond(DATASET.transport, albedo, TEST.direct[..., 1].T)
    np.testing.assert_allclose(found[:, 1].T, TEST.indirect[..., 1], rtol=1e-4)


@pytest.mark.parametrize("kind", ["cells", "surface"])
def test_patterns_share_out_the_surface_by_nearness_and_facing(kind):
    found = prior_columns(DATASET, kind)
    points, samples = DATASET.measurement_points, DATASET.transport.samples
    np.testing.assert_allclose(found.direct.sum(axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(found.measured.sum(axis=1), 1.0, rtol=1e-5)
    nearest = points[np.argmax(found.direct, axis=1)]
    np.testing.assert_allclose(np.sum(nearest.normal * samples.normal, axis=1), 1.0)
    if kind == "cells":
        np.testing.assert_allclose(found.measured, np.eye(len(points)))  # one dense point each, its own cell
    else:
        behind = points.normal @ samples.normal.T < -0.5
        assert found.direct.T[behind].max() < 0.02


def test_without_the_prior_it_is_svd_ridge_without_its_mean():
    bare = prt.method("operator-ridge", prior=0.0, ridge=1e-3, basis=8).fit(TRAIN)
    same = prt.method("svd-ridge", mean=False, transfer="per-channel", ridge=1e-3, basis=8).fit(TRAIN)
    np.testing.assert_allclose(bare.predict(TEST), same.predict(TEST), rtol=1e-8)


def test_the_matrix_is_the_estimate_under_the_mixed_covariance():
    """u = Uᵀ 𝒮 Σ Aᵀ (A Σ Aᵀ + λ)⁻¹ x, spelled out with both covariances of trace 1."""
    rng = np.random.default_rng(0)
    x, u, measured, caused = (rng.uniform(size=shape) for shape in ((6, 30), (4, 30), (6, 6), (4, 6)))
    columns, targets = mixed((jnp.asarray(x), jnp.asarray(u)), (jnp.asarray(measured), jnp.asarray(caused)), 0.3)
    found = ridge(columns, targets, relative_damping(columns, 0.02))

    light, trace = np.sum(x**2), np.sum(measured**2)
    seen = 0.7 * x @ x.T / light + 0.3 * measured @ measured.T / trace
    answer = 0.7 * u @ x.T / light + 0.3 * caused @ measured.T / trace
    np.testing.assert_allclose(found, answer @ np.linalg.inv(seen + 0.02 / 6 * np.eye(6)), rtol=1e-10)


def test_auto_takes_what_leaves_out_each_lighting_best(monkeypatch):
    """Against fits that leave each training lighting out in turn; the choice is the best pair of the grid."""
    monkeypatch.setattr(operator_ridge, "RIDGES", (1e-3, 3e-1))
    monkeypatch.setattr(operator_ridge, "_SHARES", (0.05, 0.7))
    rng = np.random.default_rng(1)
    pair, patterns = (
        [jnp.asarray(rng.normal(size=s)) for s in shapes] for shapes in (((6, 9), (3, 9)), ((6, 6), (3, 6)))
    )
    errors = {}
    for share in (0.05, 0.7):
        for factor in (1e-3, 3e-1):
            x, targets = (np.asarray(part) for part in mixed(tuple(pair), tuple(patterns), share))
            damping = relative_damping(jnp.asarray(x), factor)
            errors[factor, share] = 0.0
            for left in range(9):
                kept = np.arange(x.shape[1]) != left
                w = ridge(jnp.asarray(x[:, kept]), jnp.asarray(targets[:, kept]), damping)
                errors[factor, share] += float(np.sum((w @ pair[0][:, left] - pair[1][:, left]) ** 2))
    found = prt.method("operator-ridge")._chosen([tuple(pair)], [tuple(patterns)])
    assert tuple(float(value) for value in found) == min(errors, key=errors.get)


def test_light_that_is_constant_on_cells_is_predicted_whatever_the_lightings():
    """With the prior alone, x = E on cells goes to the projection of 𝒮 E on the basis."""
    model = prt.method("operator-ridge", prior=1.0, ridge=1e-12, basis=12).fit(TRAIN)
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (4, len(DATASET.measurement_points), 3))
    direct = np.einsum("sm,nmc->nsc", prior_columns(DATASET, "cells").direct, x)
    adjoint = importance(DATASET.transport, jnp.asarray(DATASET.transport.samples.albedo, jnp.float32), model.basis)
    expected = np.einsum("csb,nsc->nbc", adjoint, direct)
    np.testing.assert_allclose(model.transfer(jnp.asarray(x)), expected, rtol=1e-4)


def test_it_is_additive():
    model, x = prt.method("operator-ridge").fit(TRAIN), jnp.asarray(TEST.measured, jnp.float64)
    np.testing.assert_allclose(
        model.transfer(x[:1] + x[1:2]), model.transfer(x[:1]) + model.transfer(x[1:2]), rtol=1e-10
    )


def test_it_beats_svd_ridge_on_lights_never_seen():
    """At the same size and so the same run-time cost, with the same span; over three draws of lights, which differ much."""
    names = ("operator-ridge", "svd-ridge")
    found: dict[str, list[Errors]] = {name: [] for name in names}
    for seed in range(3):
        ds = example_dataset(measurements=96, seed=seed)
        for name in names:
            model = prt.method(name, basis=16).fit(ds.split("train"))
            found[name].append(prt.evaluate(model, ds.split("test")).errors)
    prior, plain = (sum(errors.relative_rmse for errors in found[name]) for name in names)
    assert prior < 0.6 * plain
    for with_prior, without in zip(*(found[name] for name in names), strict=True):
        assert with_prior.projection == pytest.approx(without.projection, rel=0.1)


def test_one_channel_serves_an_achromatic_room():
    materials = tuple(replace(material, albedo=(0.5, 0.5, 0.5)) for material in DATASET.scene.materials)
    grey = replace(DATASET, transport=replace(DATASET.transport, scene=replace(DATASET.scene, materials=materials)))
    assert prt.method("operator-ridge").fit(grey.split("train")).weights.shape[0] == 1
    assert prt.method("operator-ridge").fit(TRAIN).weights.shape[0] == 3


def test_the_basis_is_that_of_the_training_light():
    model = prt.method("operator-ridge", basis=6).fit(TRAIN)
    u, _ = leading_basis(normalised(TRAIN.measured, TRAIN.indirect).y, 6, 0.0)
    np.testing.assert_allclose(model.basis @ model.basis.T, u @ u.T, atol=1e-5)
