"""Clustered PCA: what clusters are, what their bases are, and which maps the method reduces to."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.clustered import ClusteredModel
from prt_bench.clusters import apart, bases_of_clusters, clusters_in_sight, clusters_of, in_clusters
from prt_bench.errors import FitError
from prt_bench.example import example_dataset
from prt_bench.linalg import fewer_columns, principal_rows
from prt_bench.methods.operator import fit_albedo, importance
from prt_bench.points import SurfacePoints

DATASET = example_dataset(walls=5)  # the contract's, so that kernels are compiled once
TRAIN, TEST = DATASET.split("train"), DATASET.split("test")


def error(model, ds=TEST) -> float:
    return float(np.linalg.norm(model.predict(ds) - ds.indirect) / np.linalg.norm(ds.indirect))


@cache
def fitted(ds=TRAIN, **settings) -> ClusteredModel:
    model = prt.method("clustered-pca", **settings).fit(ds)
    assert isinstance(model, ClusteredModel)
    return model


def test_clusters_are_a_packing_and_a_cover():
    points = DATASET.points
    clusters = clusters_of(points, 12, bend=0.4)
    apart_by = np.linalg.norm(clusters.roots[:, None] - clusters.roots[None], axis=2) + 10.0 * np.eye(12)
    features = np.hstack([points.position, 0.4 * points.normal])
    to_own = np.linalg.norm(features - clusters.roots[clusters.owner(points)], axis=1)
    nearest = np.linalg.norm(features[:, None] - clusters.roots[None], axis=2).min(axis=1)
    np.testing.assert_allclose(to_own, nearest, atol=1e-12)
    assert to_own.max() == pytest.approx(clusters.radius)
    assert apart_by.min() >= clusters.radius
    assert 11 <= len(clusters_of(points, 1000, bend=0.4, radius=clusters.radius)) <= 12  # distances repeat
    with pytest.raises(FitError, match="no points"):
        clusters_of(points[:0], 3, bend=0.4)


def test_a_cluster_does_not_reach_through_a_wall():
    """Both sides of a wall 1 cm thick, with spacing 20 cm: positions alone would put them together."""
    place = np.stack(np.meshgrid(np.arange(10) * 0.2, np.arange(10) * 0.2), axis=-1).reshape(-1, 2)
    front, back = (np.hstack([place, np.full((100, 1), z)]) for z in (0.0, -0.01))
    ends = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 100, axis=0)
    points = SurfacePoints(np.vstack([front, back]), ends, 0 * ends, np.zeros(200, int), 0 * ends)
    owner = clusters_of(points, 8, bend=1.0).owner(points)
    assert not set(owner[:100]) & set(owner[100:])


def test_a_wall_on_the_floor_parts_clusters_where_it_hides():
    """A wall at x = 0.7 m, which distance alone does not know of."""
    place = np.stack(np.meshgrid(np.arange(10) * 0.2, np.arange(10) * 0.2), axis=-1).reshape(-1, 2)
    up = np.repeat([[0.0, 0.0, 1.0]], 100, axis=0)
    points = SurfacePoints(np.hstack([place, np.zeros((100, 1))]), up, 0 * up, np.zeros(100, int), 0 * up)
    left = place[:, 0] < 0.7
    alone = clusters_of(points, 5, bend=2.0)
    assert any(
        0 < left[alone.owner(points) == cluster].sum() < np.sum(alone.owner(points) == cluster) for cluster in range(5)
    )
    clusters, owner = clusters_in_sight(points, 5, 2.0, lambda root: left != left[root])
    assert sorted(set(owner)) == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(left, left[clusters.chosen][owner])
    same, open_owner = clusters_in_sight(points, 5, 2.0, lambda root: np.zeros(100, bool))
    np.testing.assert_array_equal(same.chosen, alone.chosen)
    own = np.linalg.norm(points.position - points.position[same.chosen][open_owner], axis=1)
    nearest = np.linalg.norm(points.position[:, None] - points.position[same.chosen], axis=2).min(axis=1)
    np.testing.assert_allclose(own, nearest)


def test_bases_are_the_leading_singular_vectors_of_each_cluster():
    rng = np.random.default_rng(0)
    columns, owner = rng.normal(size=(30, 50)), np.arange(30) % 4
    basis = bases_of_clusters(columns, owner, 4, 3)
    for cluster in range(4):
        rows = owner == cluster
        u = np.linalg.svd(columns[rows], full_matrices=False)[0][:, :3]
        np.testing.assert_allclose(basis[rows] @ basis[rows].T, u @ u.T, atol=1e-10)
    wide = apart(basis, owner, 4)
    np.testing.assert_allclose(wide.T @ wide, np.eye(12), atol=1e-12)
    np.testing.assert_allclose(in_clusters(basis, columns, owner, 4), wide.T @ columns, atol=1e-12)


def test_fewer_columns_keep_the_outer_product():
    for shape in ((5, 9), (9, 5)):
        matrix = np.random.default_rng(0).normal(size=shape)
        found = np.asarray(fewer_columns(jnp.asarray(matrix)))
        assert found.shape == (shape[0], 5)
        np.testing.assert_allclose(found @ found.T, matrix @ matrix.T, atol=1e-12)


def test_principal_rows_are_singular_vectors_few_of_many_and_all():
    rng = np.random.default_rng(0)
    for shape, count in (((90, 60), 4), ((60, 90), 4), ((9, 20), 5), ((20, 9), 30)):
        matrix = rng.normal(size=shape) * np.linspace(1, 2, shape[1])
        found, vt = principal_rows(matrix, count), np.linalg.svd(matrix, full_matrices=False)[2][:count]
        np.testing.assert_allclose(found.T @ found, vt.T @ vt, atol=1e-8)
    assert principal_rows(np.zeros((3, 5)), 2).shape == (0, 5)
    assert principal_rows(np.outer(np.arange(9.0), np.ones(7)), 3).shape == (1, 7)


def test_span_is_what_reconstruct_multiplies():
    rng = np.random.default_rng(0)
    owner = jnp.asarray(rng.integers(0, 4, 20), jnp.float64)
    model = ClusteredModel(jnp.asarray(rng.normal(size=(20, 3))), owner, jnp.zeros((1, 12, 6)))
    u = rng.normal(size=(2, 12, 3))
    np.testing.assert_allclose(model.reconstruct(u), np.einsum("tb,nbc->ntc", model.span, u), atol=1e-12)


def test_with_every_vector_it_is_the_operator_after_a_regression():
    """As many vectors as a cluster has rows keep all: then y = 𝒮 · (ridge from measured to direct light), by the adjoint."""
    streamed, ridge = DATASET.streamed, 1e-3
    model = fitted(clusters=4, basis=180, sources=180, prior=0.0, ridge=ridge)
    adjoint = np.asarray(importance(DATASET.transport, fit_albedo(DATASET), jnp.eye(180)))
    direct, x = np.asarray(streamed.direct).T.astype(float), streamed.measured.T.astype(float)
    caused = np.einsum("cst,sn->tcn", adjoint, direct)
    size = np.hypot(
        np.linalg.norm(caused, axis=(0, 1)) / (180 * 3) ** 0.5, 0.1 * np.linalg.norm(x, axis=0) / len(x) ** 0.5
    )
    lit = size > 0
    x, direct = (light[:, lit] / size[lit] for light in (x, direct))
    damping = ridge * np.sum(x**2) / len(x)
    regression = np.linalg.solve(x @ x.T + damping * np.eye(len(x)), x @ direct.T).T
    wanted = np.einsum("cst,sm,nmc->ntc", adjoint, regression, TEST.measured)
    np.testing.assert_allclose(model.predict(TEST), wanted, atol=2e-5 * wanted.max())


def test_brightness_of_lightings_does_not_weigh():
    scale = 10.0 ** np.linspace(-4, 4, len(DATASET.streamed.measured))[:, None]
    arrays = {**DATASET.arrays}
    for name in ("streamed_direct", "streamed_measured"):
        arrays[name] = np.asarray(arrays[name], float) * scale
    bright = fitted(replace(DATASET, arrays=arrays).split("train"))
    np.testing.assert_allclose(bright.predict(TEST), fitted().predict(TEST), rtol=1e-5, atol=1e-5 * TEST.indirect.max())


def test_without_streamed_lightings_it_learns_from_the_training_ones():
    arrays = {key: value for key, value in DATASET.arrays.items() if not key.startswith("streamed")}
    alone = fitted(replace(DATASET, arrays=arrays).split("train"))
    assert error(alone) < 1.5 * error(fitted())
    assert error(alone, TRAIN) < 0.35
