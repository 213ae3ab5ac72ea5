"""Transfer vectors on OpenGL against JAX: projection of light, textures, vertices, and frames without shadow maps."""

import numpy as np
import pytest

import prt_bench as prt
from prt_bench.errors import AssetError
from prt_bench.example import example_dataset
from prt_bench.harmonic import HarmonicModel
from prt_bench.runtime import Runtime
from prt_bench.runtime.timing import time_assets

LIGHTS = [
    prt.DirectionalLight((0.2, -0.3, -1.0), (1.0, 2.0, 3.0)),
    prt.DirectionalLight((0.5, 0.3, -1.0), (0.0, 2.0, 0.5)),
    prt.PointLight((0.1, 0.2, 3.0), (4.0, 5.0, 6.0)),
]


@pytest.fixture(scope="module")
def room():
    return example_dataset(walls=5)


@pytest.fixture(scope="module")
def window(room):
    return Runtime(room, size=(96, 72), shadow_resolution=256)


def relative(found, wanted) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


SUBJECTS = [
    ("sh-texture", {"order": 5}),
    ("sh-texture", {"order": 1}),
    ("sh-texture", {"order": 8, "window": "hann"}),
    ("sh-texture", {"light": "indirect"}),
    ("sh-vertex", {"order": 5}),
]


@pytest.mark.parametrize(("name", "settings"), SUBJECTS)
@pytest.mark.parametrize("storage", ["float32", "float16"])
def test_every_stage_agrees_with_the_model(name, settings, storage, room, window, tmp_path):
    asset = prt.method(name, **settings).fit(room).export(tmp_path / "asset", storage)
    loaded, model = window.load(asset), asset.model()
    lit = [window.light(prt.Lighting([light])) for light in LIGHTS]
    for light, uploaded in zip(LIGHTS, lit, strict=True):
        observed = Observed([prt.Lighting([light])])
        x = np.asarray(model.measure(observed))[0]
        loaded.measure(uploaded)
        assert relative(loaded.measured(), x) < 2e-6
        assert relative(loaded.coefficients_of(x), x) < 1e-7
        assert relative(loaded.predict(x), np.asarray(model.reconstruct(x[None]))[0]) < 2e-6


class Observed:
    """What a model of distant light looks at."""

    def __init__(self, lightings):
        self.lightings = lightings
        self.measured = np.zeros((len(lightings), 1, 3))


def test_a_frame_holds_all_light_without_shadow_maps(room, window, tmp_path):
    """With or without the runtime's direct light asked for, and as the same lightmap shows it."""
    model = prt.method("sh-texture").fit(room)
    loaded = window.load(model.export(tmp_path / "asset"))
    lighting = prt.Lighting([LIGHTS[0]])
    frame = window.frame(lighting, loaded)
    np.testing.assert_array_equal(frame, window.frame(lighting, loaded, direct=False))
    shown = np.asarray(model.predict(Observed([lighting])))[0]
    np.testing.assert_allclose(frame, window.frame(lighting, window.lightmap(shown), direct=False), atol=2e-5)
    assert not loaded.needs_shadows


def test_indirect_light_alone_leaves_direct_light_to_the_runtime(room, window, tmp_path):
    loaded = window.load(prt.method("sh-texture", light="indirect").fit(room).export(tmp_path / "asset"))
    lighting = prt.Lighting([LIGHTS[0]])
    both = window.frame(lighting, loaded)
    apart = window.frame(lighting) + window.frame(lighting, loaded, direct=False)
    np.testing.assert_allclose(both, apart, atol=1e-5)
    assert loaded.needs_shadows


def test_vertices_are_interpolated_over_the_picture(tmp_path):
    """The rasteriser's interpolation, seen in the frame, is that of the model at the texels."""
    room = example_dataset(texels=24, rays=16, walls=5)
    window = Runtime(room, size=(96, 72), shadow_resolution=256)
    model = prt.method("sh-vertex").fit(room)
    loaded = window.load(model.export(tmp_path / "asset"))
    lighting = prt.Lighting([LIGHTS[0]])
    shown = window.lightmap(np.asarray(model.predict(Observed([lighting])))[0])
    frame, wanted = window.frame(lighting, loaded), window.frame(lighting, shown, direct=False)
    off = np.abs(frame - wanted).max(axis=2) > 0.02 * wanted.max()
    assert off.mean() < 0.03  # at a wall's border: texels are not extrapolated there


def test_stages_are_timed_without_shadows_where_there_are_none(room, window, tmp_path):
    names = {"sh-texture": {}, "sh-vertex": {}, "svd-ridge": {"basis": 4}}
    loaded = {
        name: window.load(prt.method(name, **settings).fit(room.split("train")).export(tmp_path / name))
        for name, settings in names.items()
    }
    timings = time_assets(loaded, prt.Lighting([LIGHTS[0]]), rounds=1, warmup=0)
    assert "shadow" in timings["svd-ridge"][0].stages
    for name in ("sh-texture", "sh-vertex"):
        assert list(timings[name][0].stages) == ["measure", "transfer", "draw", "frame"]
        assert timings[name][0].baseline is None


def test_what_does_not_fit_is_refused(room, window, tmp_path):
    model = prt.method("sh-vertex").fit(room)
    small = type(model)(model.basis[:3], model.centre, model.corner, model.barycentric)
    with pytest.raises(AssetError, match="3 vertices, but the dataset has 20"):
        window.load(small.export(tmp_path / "small"))
    pair = HarmonicModel(np.ones((len(room.points), 2, 4), np.float32), np.zeros(3, np.float32))
    with pytest.raises(AssetError, match="2 channels"):
        window.load(pair.export(tmp_path / "pair"))
