"""A basis for each cluster in the runtime: against the model at the receivers, and against plain light across borders."""

import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.clustered import ClusteredModel
from prt_bench.lights import Lighting, PointLight
from prt_bench.models import LinearModel

pytestmark = pytest.mark.gl

CLUSTERS = 5
LIGHT = Lighting((PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0)),))


def clustered(ds, size: int, channels: int) -> ClusteredModel:
    """Random weights, and clusters that are mixed as finely as texels are."""
    rng = np.random.default_rng(size)
    receivers, columns = len(ds.points), len(ds.groups) + 1
    return ClusteredModel(
        jnp.asarray(rng.normal(size=(receivers, size))),
        jnp.asarray(rng.integers(0, CLUSTERS, receivers), jnp.float64),
        jnp.asarray(rng.normal(size=(channels, CLUSTERS * size, columns))),
    )


@pytest.mark.parametrize(("size", "channels", "dtype"), [(1, 1, "float32"), (6, 3, "float16"), (8, 1, "float32")])
def test_clustered_assets_predict_as_in_jax(size, channels, dtype, cornell, runtime, export):
    asset = export(clustered(cornell, size, channels), dtype)
    x = np.random.default_rng(1).random((len(cornell.groups), 3)).astype(np.float32)
    model, loaded = asset.model(), runtime.load(asset)
    u = np.asarray(model.transfer(jnp.asarray(x[None])))
    y = np.asarray(model.reconstruct(jnp.asarray(u)))[0]
    np.testing.assert_allclose(loaded.coefficients_of(x), u[0], atol=1e-5 * np.abs(u).max())
    np.testing.assert_allclose(loaded.predict(x), y, atol=1e-5 * np.abs(y).max())


def test_light_is_interpolated_across_borders_of_clusters(cornell, runtime, export):
    """Two clusters that say the same light by different functions: frames are those of a basis of one constant."""
    receivers, columns = len(cornell.points), len(cornell.groups) + 1
    owner = np.random.default_rng(0).integers(0, 2, receivers)
    basis = np.where(owner[:, None] == np.arange(2), (1.0, 4.0), 0.0)
    weights = np.zeros((1, 4, columns))
    weights[0, [0, 3], -1] = 1.0, 0.25
    plain = np.zeros((1, 1, columns))
    plain[0, 0, -1] = 1.0
    models = (
        ClusteredModel(jnp.asarray(basis), jnp.asarray(owner, jnp.float64), jnp.asarray(weights)),
        LinearModel(jnp.ones((receivers, 1)), jnp.asarray(plain)),
    )
    found, wanted = (runtime.frame(LIGHT, runtime.load(export(model)), direct=False) for model in models)
    assert wanted.max() > 0
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6 * wanted.max())


def test_bytes_grow_with_the_functions_of_one_cluster(cornell, runtime, export):
    """Six values of each texel and its cluster in two layers of four, however many clusters there are."""
    texels = cornell.lightmap.resolution**2
    loaded = runtime.load(export(clustered(cornell, 6, 1), "float16"))
    assert loaded.bytes == texels * 8 * 2 + 4 * CLUSTERS * 6 * 65 + 16 * 32
