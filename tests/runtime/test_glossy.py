"""Glossy transfer on OpenGL against JAX: generated code, matrices of the light, and what a scene calls for."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.environment import EnvironmentMap
from prt_bench.example import example_dataset
from prt_bench.frames import FrameComparison
from prt_bench.methods.interreflection import fix_light
from prt_bench.runtime import Runtime
from prt_bench.runtime.glossy import GlossyAsset
from prt_bench.scene import Glossy
from prt_bench.spec import TimeSpec

LIGHTING = prt.Lighting(
    [
        prt.DirectionalLight((0.2, -0.3, -1.0), (1.0, 2.0, 3.0)),
        prt.DirectionalLight((-0.5, 0.3, -1.0), (1.0, 0.5, 0.2)),
    ]
)


class Observed:
    def __init__(self, lighting):
        self.lightings = [lighting]
        self.measured = np.zeros((1, 1, 3))


def glossy_room(**lobe):
    ds = example_dataset(texels=8, walls=5)
    scene = ds.scene
    shiny = replace(scene.materials[0], albedo=(0.5, 0.5, 0.5), glossy=Glossy(**lobe))
    materials = (shiny, *scene.materials[1:])
    return replace(ds, transport=replace(ds.transport, scene=replace(scene, materials=materials)))


@pytest.fixture(scope="module")
def room():
    return glossy_room(specular=(0.3, 0.2, 0.1), exponent=12.0)


@pytest.fixture(scope="module")
def window(room):
    return Runtime(room, size=(96, 72), shadow_resolution=256)


def relative(found, wanted) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


@pytest.mark.parametrize("name", ["sh-triple", "sh-triple-fixed"])
@pytest.mark.parametrize("order", [1, 3, 5])
def test_lobes_agree_with_the_model(name, order, room, window, tmp_path):
    rng = np.random.default_rng(order)
    mirror = rng.normal(size=(len(room.points), 3))
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    exponent = 10.0 ** rng.uniform(0, 3, len(mirror))
    asset = prt.method(name, order=order).fit(room).export(tmp_path / "asset")
    model = asset.model()
    x = np.asarray(model.measure(Observed(LIGHTING)), np.float32)[0]
    wanted = model.gloss(x[None], jnp.asarray(mirror, jnp.float32), jnp.asarray(exponent, jnp.float32))[0]
    loaded = window.load(asset)
    assert relative(loaded.gloss(x, mirror, exponent), wanted) < 2e-6
    assert relative(loaded.predict(x), np.asarray(model.reconstruct(x[None]))[0]) < 2e-6
    if name == "sh-triple" and order == 3:
        dense = GlossyAsset(window, asset, dense=True)
        assert relative(dense.gloss(x, mirror, exponent), wanted) < 2e-6


def test_frames_hold_diffuse_light_and_lobes(room, window, tmp_path):
    """Both ways of taking the product show the same frame; its difference to the diffuse one is where the lobes are."""
    frames = {}
    for name in ("sh-texture", "sh-triple", "sh-triple-fixed"):
        loaded = window.load(prt.method(name).fit(room).export(tmp_path / name))
        frames[name] = window.frame(LIGHTING, loaded)
    assert relative(frames["sh-triple"], frames["sh-triple-fixed"]) < 1e-5
    added = frames["sh-triple"] - frames["sh-texture"]
    assert added.min() > -1e-5
    shiny = added.max(axis=2) > 1e-4
    assert 0.1 < shiny.mean() < 0.95
    red, green, blue = added[shiny].mean(axis=0) / np.array([0.3, 0.2, 0.1])
    assert min(red, green, blue) > 0


def test_lobes_of_a_frame_look_along_the_mirror_direction(room, window, tmp_path):
    """At the pixel where the camera's axis meets the back wall, against the model at the four texels around."""
    model = prt.method("sh-triple").fit(room)
    loaded, dull = (window.load(m.export(tmp_path / name)) for name, m in
                    (("shiny", model), ("dull", prt.method("sh-texture").fit(room))))  # fmt: skip
    added = (window.frame(LIGHTING, loaded) - window.frame(LIGHTING, dull))[35:37, 47:49].mean(axis=(0, 1))
    points = room.points
    middle = np.argsort(np.linalg.norm(points.position - [0.0, 0.0, -1.0], axis=1))[:4]
    mirror = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    lobe = np.asarray(model.gloss(model.measure(Observed(LIGHTING)), mirror, np.full(len(points), 12.0)))[0, middle]
    wanted = np.maximum(lobe.mean(axis=0), 0.0) * [0.3, 0.2, 0.1]
    np.testing.assert_allclose(added, wanted, rtol=0.05, atol=1e-4)


def test_roughness_may_vary_over_the_surface(tmp_path):
    """An even roughness image is the exponent it stands for."""
    roughness = np.sqrt(2.0 / 14.0)
    frames = []
    for lobe in ({"exponent": 12.0}, {"roughness_image": np.full((4, 4), roughness)}):
        ds = glossy_room(specular=(0.3, 0.3, 0.3), **lobe)
        mesh = replace(ds.scene.mesh, uv=np.zeros((len(ds.scene.mesh.faces), 3, 2)))
        ds = replace(ds, transport=replace(ds.transport, scene=replace(ds.scene, mesh=mesh)))
        window = Runtime(ds, size=(64, 48), shadow_resolution=128)
        loaded = window.load(prt.method("sh-triple-fixed", order=3).fit(ds).export(tmp_path / "asset"))
        frames.append(window.frame(LIGHTING, loaded))
    np.testing.assert_allclose(frames[1], frames[0], rtol=1e-4, atol=1e-6)


def test_a_diffuse_scene_compiles_no_lobe(tmp_path):
    ds = example_dataset(texels=6, walls=5)
    window = Runtime(ds, size=(48, 36), shadow_resolution=128)
    loaded = window.load(prt.method("sh-triple").fit(ds).export(tmp_path / "asset"))
    assert "GLOSSY" not in loaded._kernel
    plain = window.load(prt.method("sh-texture").fit(ds).export(tmp_path / "plain"))
    np.testing.assert_array_equal(window.frame(LIGHTING, loaded), window.frame(LIGHTING, plain))


@pytest.mark.parametrize("order", [2, 5])
def test_inter_reflections_of_fixed_light_agree_with_the_model(order, room, window, tmp_path):
    """At the receivers, diffuse and by lobes; and a frame shows more of them than of direct light alone."""
    model = fix_light(room, LIGHTING, order)
    asset = model.export(tmp_path / "asset")
    loaded, model = window.load(asset), asset.model()
    x = np.asarray(model.measure(Observed(LIGHTING)), np.float32)[0]
    mirror = np.random.default_rng(0).normal(size=(len(room.points), 3))
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    exponent = np.full(len(mirror), 12.0)
    wanted = model.gloss(x[None], jnp.asarray(mirror, jnp.float32), jnp.asarray(exponent, jnp.float32))[0]
    assert relative(loaded.gloss(x, mirror, exponent), wanted) < 2e-6
    assert relative(loaded.predict(x), np.asarray(model.reconstruct(x[None]))[0]) < 2e-6
    alone = prt.method("sh-triple", order=order, interreflection=False).fit(room).export(tmp_path / "alone")
    added = window.frame(LIGHTING, loaded) - window.frame(LIGHTING, window.load(alone))
    assert added.min() > -1e-5
    assert added.mean() > 0.01


def test_frames_of_glossy_scenes_are_compared_with_path_traced_lobes(room, tmp_path, monkeypatch):
    """Lobes bring a frame closer, where a diffuse reference would make them an error; diffuse scenes trace no path."""
    sky = np.ones((8, 16, 3), np.float32) * np.linspace(0.2, 2.0, 16, dtype=np.float32)[:, None]
    light = prt.Lighting([prt.EnvironmentLight(EnvironmentMap("gradient", sky))])
    indirect = prt.method("sh-texture", light="indirect").fit(room)
    bounced = np.asarray(indirect.reconstruct(indirect.measure(Observed(light))), np.float32)
    count = len(room.all_lightings)
    arrays = {**room.arrays, "indirect": np.repeat(bounced, count, axis=0)}
    ds = replace(room, all_lightings=(light,) * count, arrays=arrays).split("test")
    comparison = FrameComparison(ds, TimeSpec(size=(64, 48), shadow_resolution=128), tmp_path)
    scores = []
    for name in ("sh-triple", "sh-texture"):
        model = prt.method(name).fit(ds)
        loaded = comparison.runtime.load(model.export(tmp_path / name))
        record = prt.evaluate(model, ds, loaded.asset)
        scores.append(comparison.complete(record, model, loaded, ds).errors.flip)
    assert scores[0] < 0.93 * scores[1]

    monkeypatch.setattr("prt_bench.frames.reference_image", None)
    dull = example_dataset(texels=6, walls=5).split("test")
    plain = FrameComparison(dull, TimeSpec(size=(32, 24), shadow_resolution=64), tmp_path)
    assert plain._reference(dull).display.shape == (24, 32, 3)
