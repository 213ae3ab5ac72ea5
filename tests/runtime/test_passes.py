"""Each pass against an independent computation: closed forms, the JAX model, and traced shadow rays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.direct import direct_irradiance
from data_gen.tracer import Tracer
from prt_bench.errors import AssetError, LightError
from prt_bench.lights import (
    DirectionalLight,
    EnvironmentLight,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
    SpotLight,
    emitters,
    irradiance,
)
from prt_bench.runtime import Runtime
from prt_bench.runtime.projection import corners
from prt_bench.runtime.views import shadow_views

from .conftest import coupled_model, gamma_model, linear_model, nearest_model, quad_dataset

pytestmark = pytest.mark.gl

SKY = np.random.default_rng(0).random((8, 16, 3))
LIGHTS = {
    "point": PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0)),
    "spot": SpotLight((0.5, 1.7, 0.8), (-0.4, -1.0, -0.7), (5.0, 6.0, 7.0)),
    "wide-spot": SpotLight((0.5, 1.2, 0.8), (-0.4, -1.0, -0.7), (5.0, 6.0, 7.0), 1.4, 0.5),
    "directional": DirectionalLight((0.2, -0.5, -1.0), (3.0, 2.0, 1.0)),
    "sphere": SphereLight((0.2, 1.5, 0.5), 0.1, (9.0, 8.0, 7.0)),
    "rect": RectLight((0.0, 1.98, 0.0), (0.3, 0.0, 0.0), (0.0, 0.0, 0.3), (9.0, 9.0, 5.0)),
    "environment": EnvironmentLight(SKY, (0.3, 0.2, 0.1)),
}
AREA = ("sphere", "rect", "environment")


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


@pytest.fixture(scope="module")
def unshadowed(cornell):
    return Runtime(cornell, size=(16, 16), shadow_resolution=256, shadows=False)


@pytest.mark.parametrize("name", LIGHTS)
def test_unoccluded_measurement_is_the_closed_form(name, cornell, unshadowed):
    lighting = Lighting([LIGHTS[name]])
    lights = jax.tree.map(lambda leaf: leaf[0], emitters([lighting]))
    points = cornell.dense_points
    wanted = irradiance(lights, jnp.asarray(points.position), jnp.asarray(points.normal))[cornell.groups].mean(axis=1)
    np.testing.assert_allclose(unshadowed.measure(lighting), wanted, rtol=1e-4, atol=1e-5 * float(jnp.max(wanted)))


def test_light_of_several_lights_adds_up(unshadowed):
    chosen = [LIGHTS["point"], LIGHTS["directional"]]
    together = unshadowed.measure(Lighting(chosen))
    apart = sum(unshadowed.measure(Lighting([light])) for light in chosen)
    np.testing.assert_allclose(together, apart, rtol=1e-5)


@pytest.mark.parametrize("supersamples", [1, 3, 100])
def test_any_supersampling(supersamples, cornell):
    ds = quad_dataset(cornell.scene, cell=4, measurements=7, supersamples=supersamples)
    lighting = Lighting([LIGHTS["point"]])
    lights = jax.tree.map(lambda leaf: leaf[0], emitters([lighting]))
    points = ds.dense_points
    wanted = irradiance(lights, jnp.asarray(points.position), jnp.asarray(points.normal))[ds.groups].mean(axis=1)
    found = Runtime(ds, size=(16, 16), shadow_resolution=64, shadows=False).measure(lighting)
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


@pytest.fixture(scope="module")
def single_points(cornell):
    return quad_dataset(cornell.scene, cell=4, measurements=4000, supersamples=1)


@pytest.mark.parametrize("name", LIGHTS)
def test_shadow_maps_agree_with_shadow_rays(name, single_points, record_property):
    lighting = Lighting([LIGHTS[name]])
    found = Runtime(single_points, size=(16, 16), shadow_resolution=2048).measure(lighting)
    tracer = Tracer(single_points.scene)
    traced, open_ = (
        direct_irradiance(tracer, single_points.dense_points, emitters([lighting]), rays)[0] for rays in (True, False)
    )
    lit = open_.max(axis=1) > 0
    difference = np.abs(found - traced).max(axis=1)[lit] / open_.max(axis=1)[lit]
    share = float(np.mean(difference > 0.05))
    record_property("differing_share", share)
    record_property("relative_rmse", relative(found, traced))
    assert np.mean(traced[lit] < 0.9 * open_[lit]) > 0.05, "the test needs shadows"
    assert share < (0.04 if name in AREA else 0.01)
    assert relative(found, traced) < 0.08


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_shadows_do_not_depend_on_scale(scale, single_points, runtime):
    def measured(factor: float) -> np.ndarray:
        ds = scaled(single_points, factor)
        light = PointLight(factor * np.array([0.1, 1.6, 0.2]), np.full(3, 5.0 * factor**2), 0.01 * factor)
        return Runtime(ds, size=(16, 16), shadow_resolution=1024).measure(Lighting([light]))

    one, other = measured(1.0), measured(scale)
    assert np.mean(np.abs(one - other).max(axis=1) > 0.02 * one.max()) < 0.005


def scaled(ds, factor):
    """The same dataset with all positions multiplied."""
    from dataclasses import replace

    from prt_bench.points import SurfacePoints

    mesh = replace(ds.scene.mesh, vertices=ds.scene.mesh.vertices * factor)
    scene = replace(ds.scene, mesh=mesh)
    old = ds.dense_points
    dense = SurfacePoints(old.position * factor, old.normal, old.albedo, old.face, old.barycentric)
    return replace(ds, transport=replace(ds.transport, scene=scene), dense_points=dense)


def test_every_view_sees_the_whole_scene(cornell):
    bounds = cornell.scene.bounds
    points = np.column_stack([corners(bounds), np.ones(8)])
    for name in ("point", "directional"):
        lights = jax.tree.map(lambda leaf: np.asarray(leaf[0]), emitters([Lighting([LIGHTS[name]])]))
        views = shadow_views(lights, bounds, 1024)
        clip = np.einsum("vij,pj->vpi", views.matrix, points)
        inside = np.all(np.abs(clip[..., :3]) <= clip[..., 3:], axis=-1)
        assert inside.any(axis=0).all(), f"{name}: a corner of the scene is in no view"


def test_too_many_views_are_refused(cornell):
    lights = jax.tree.map(lambda leaf: np.asarray(leaf[0]), emitters([Lighting([LIGHTS["sphere"]] * 4)]))
    with pytest.raises(LightError, match="shadow_resolution"):
        shadow_views(lights, cornell.scene.bounds, 256)


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("basis", [1, 6, 16])
def test_linear_assets_predict_as_in_jax(dtype, channels, basis, cornell, runtime, export):
    asset = export(linear_model(cornell, basis, channels), dtype)
    x = np.random.default_rng(basis).random((len(cornell.groups), 3)).astype(np.float32)
    model, loaded = asset.model(), runtime.load(asset)
    u = model.transfer(jnp.asarray(x[None]))
    assert relative(loaded.coefficients_of(x), np.asarray(u[0])) < 1e-5
    assert relative(loaded.predict(x), np.asarray(model.reconstruct(u)[0])) < 1e-5


def test_coupled_channels_predict_as_in_jax(cornell, runtime, export):
    for basis, dtype in ((1, "float32"), (6, "float16"), (16, "float32")):
        asset = export(coupled_model(cornell, basis), dtype)
        x = np.random.default_rng(basis).random((len(cornell.groups), 3)).astype(np.float32)
        model, loaded = asset.model(), runtime.load(asset)
        u = model.transfer(jnp.asarray(x[None]))
        assert loaded.coefficients_of(x).shape == u.shape[1:] == (basis, 1)
        assert relative(loaded.coefficients_of(x), np.asarray(u[0])) < 1e-5
        assert relative(loaded.predict(x), np.asarray(model.reconstruct(u)[0])) < 1e-5


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("form", ["shared", "per-channel", "coupled"])
def test_gamma_space_predicts_as_in_jax(form, dtype, cornell, runtime, export):
    """Bright, dark, unlit and negative values at once; a channel of its own may be black."""
    plain = {
        "shared": lambda: linear_model(cornell, 6),
        "per-channel": lambda: linear_model(cornell, 6, 3),
        "coupled": lambda: coupled_model(cornell, 6),
    }[form]()
    asset = export(gamma_model(plain), dtype)
    rng = np.random.default_rng(7)
    x = (rng.normal(size=(len(cornell.groups), 3)) * 10.0 ** rng.uniform(-5, 1, (len(cornell.groups), 3))).astype("f4")
    x[::3], x[:, 2] = 0.0, 0.0
    model, loaded = asset.model(), runtime.load(asset)
    u = model.transfer(jnp.asarray(x[None]))
    assert relative(loaded.coefficients_of(x), np.asarray(u[0])) < 1e-5
    found, wanted = loaded.predict(x), np.asarray(model.reconstruct(u)[0])
    assert (wanted < 0).any()
    assert relative(found, wanted) < 1e-4
    linear = np.asarray(plain.reconstruct(plain.transfer(jnp.asarray(x[None])))[0])
    assert relative(0.05 * linear, wanted) > 0.5


def test_coupling_of_other_than_three_channels_is_refused(cornell, runtime, export):
    with pytest.raises(AssetError, match="couples 2 channels"):
        runtime.load(export(coupled_model(cornell, 4, channels=2)))


@pytest.mark.parametrize("scale", [0.0, 1e-25, 1e25])
@pytest.mark.parametrize("form", [linear_model, coupled_model])
def test_transfer_is_homogeneous_at_any_brightness(form, scale, cornell, runtime, export):
    loaded = runtime.load(export(form(cornell, 4)))
    x = np.random.default_rng(3).random((len(cornell.groups), 3)).astype(np.float32)
    wanted = loaded.coefficients_of(x) * np.float32(scale)
    np.testing.assert_allclose(loaded.coefficients_of(x * np.float32(scale)), wanted, rtol=1e-4)


@pytest.mark.parametrize("scale", [0.0, 1e-25, 1e25])
def test_gamma_space_is_homogeneous_at_any_brightness(scale, cornell, runtime, export):
    loaded = runtime.load(export(gamma_model(linear_model(cornell, 4))))
    x = np.random.default_rng(3).random((len(cornell.groups), 3)).astype(np.float32)
    plain, scaled = loaded.predict(x), loaded.predict(x * np.float32(scale))
    if scale == 0.0:
        assert not scaled.any()
    else:
        assert relative(scaled / np.float32(scale), plain) < 1e-5


def test_nearest_assets_predict_as_in_jax(cornell, runtime, export):
    asset = export(nearest_model(cornell, 300))
    model, loaded = asset.model(), runtime.load(asset)
    rng = np.random.default_rng(0)
    for chosen in ((0, 0, 0), (3, 299, 17)):
        near = np.asarray(model.directions)[list(chosen)].T
        x = (2.0 * near + 0.01 * rng.random(near.shape)).astype(np.float32)
        u = model.transfer(jnp.asarray(x[None]))
        assert np.argmax(np.asarray(u[0]), axis=0).tolist() == list(chosen)
        assert relative(loaded.coefficients_of(x), np.asarray(u[0])) < 1e-5
        assert relative(loaded.predict(x), np.asarray(model.reconstruct(u)[0])) < 1e-5
    assert not loaded.predict(np.zeros_like(x)).any()


def test_assets_of_another_dataset_are_refused(cornell, runtime, export):
    other = quad_dataset(cornell.scene, cell=8, measurements=64)
    with pytest.raises(AssetError, match="receivers"):
        runtime.load(export(linear_model(other, 4)))
    other = quad_dataset(cornell.scene, measurements=32)
    with pytest.raises(AssetError, match="measurement points"):
        runtime.load(export(linear_model(other, 4)))
    with pytest.raises(AssetError, match="32 measurement points"):
        runtime.load(export(coupled_model(other, 4)))


def test_bytes_on_the_gpu(cornell, runtime, export):
    texels = cornell.lightmap.resolution**2
    whole, half = (runtime.load(export(linear_model(cornell, 6), dtype)) for dtype in ("float32", "float16"))
    others = 4 * 6 * 65 + 16 * 8
    assert whole.bytes == texels * 8 * 4 + others
    assert half.bytes == texels * 8 * 2 + others
    coupled = runtime.load(export(coupled_model(cornell, 6)))
    assert coupled.bytes == texels * 3 * 8 * 4 + 4 * 6 * (3 * 64 + 1) + 16 * 8
