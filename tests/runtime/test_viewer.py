"""The viewer: its camera, what its events change, the command that opens it, and its refusals."""

import sys
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

import prt_bench as prt
from data_gen.assets import environment_maps
from prt_bench.cli import main
from prt_bench.errors import RuntimeUnavailable
from prt_bench.lights import Lighting, PointLight
from prt_bench.runtime import Runtime, viewer
from prt_bench.runtime.viewer import Orbit, view
from prt_bench.scene import Camera

CAMERA = Camera((1.6, 1.5, 4.0), (0.0, 0.6, 0.0), fov_y=36.0)
LIGHTINGS = [Lighting([PointLight((x, 1.6, 0.2), (5.0, 4.0, 3.0))]) for x in (-0.5, 0.5)]


def test_an_orbit_begins_at_its_camera():
    found = Orbit.of(CAMERA).camera
    np.testing.assert_allclose(found.position, CAMERA.position, rtol=1e-12)
    assert (found.target, found.fov_y) == (CAMERA.target, CAMERA.fov_y)


def test_turning_keeps_the_distance_and_stops_at_the_poles():
    orbit = Orbit.of(CAMERA)
    for yaw, pitch in ((0.3, 0.2), (2.0, -5.0), (0.0, 9.0)):
        turned = orbit.turned(yaw, pitch).camera
        away = np.subtract(turned.position, turned.target)
        assert np.isclose(np.linalg.norm(away), orbit.distance)
        assert np.hypot(away[0], away[2]) > 0.01 * orbit.distance
    right = orbit.turned(0.1, 0.0).camera
    assert np.dot(np.subtract(right.position, CAMERA.position), (4.0, 0.0, -1.6)) > 0


class FakeTk:
    """A window that keeps what it is told: the last picture, the title, and what its events are bound to."""

    def __init__(self) -> None:
        self.bound: dict[str, Callable] = {}
        self.picture = np.zeros(0)
        self.text = ""
        self.steps: Callable[[FakeTk], None] = lambda _: None

    def bind(self, event: str, act: Callable) -> None:
        self.bound[event] = act

    def title(self, text: str) -> None:
        self.text = text

    def mainloop(self) -> None:
        self.steps(self)

    def fire(self, event: str, **details: int) -> np.ndarray:
        """Send an event; the picture before it."""
        before = self.picture
        self.bound[event](SimpleNamespace(**details))
        return before


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> FakeTk:
    made = FakeTk()

    def label(window: FakeTk, **_: object) -> SimpleNamespace:
        return SimpleNamespace(pack=lambda: None, configure=lambda image: setattr(window, "picture", image))

    monkeypatch.setattr(viewer.tkinter, "Tk", lambda: made)
    monkeypatch.setattr(viewer.tkinter, "Label", label)
    monkeypatch.setattr(viewer.ImageTk, "PhotoImage", lambda image, master: np.asarray(image, int))
    return made


@pytest.mark.gl
def test_events_change_what_the_window_shows(cornell, window):
    runtime = Runtime(cornell, size=(64, 48), shadow_resolution=256)
    indirect = runtime.lightmap(np.ones((runtime.layout.receivers, 3)))

    def steps(window: FakeTk) -> None:
        assert window.picture.shape == (48, 64, 3)
        assert "lighting 0" in window.text
        before = window.fire("i")
        assert (window.picture <= before).all()
        assert window.picture.sum() < before.sum(), "without indirect light it is darker"
        np.testing.assert_array_equal(window.fire("d"), window.picture)  # one of the two stays on
        window.fire("i")
        alone = window.picture
        assert not np.array_equal(alone, before)
        window.fire("d")
        np.testing.assert_array_equal(window.picture, before)
        assert not np.array_equal(window.fire("<space>"), window.picture)
        assert "lighting 1" in window.text
        window.fire("<space>")
        np.testing.assert_array_equal(window.picture, before)
        window.fire("+")
        assert window.picture.sum() > before.sum()
        window.fire("<minus>")
        window.fire("<ButtonPress-1>", x=10, y=10)
        window.fire("<B1-Motion>", x=30, y=15)
        assert not np.array_equal(window.picture, before)
        window.fire("<B1-Motion>", x=10, y=10)
        np.testing.assert_allclose(window.picture, before, atol=1)
        window.fire("<Button-4>")
        assert not np.array_equal(window.picture, before), "nearer"

    window.steps = steps
    view(runtime, LIGHTINGS, indirect, cornell.scene.camera)


@pytest.mark.gl
def test_brackets_turn_distant_light(cornell, window):
    runtime = Runtime(cornell, size=(64, 48), shadow_resolution=256)
    indirect = runtime.lightmap(np.zeros((runtime.layout.receivers, 3)))

    def steps(window: FakeTk) -> None:
        before = window.picture
        window.fire("]")
        assert not np.array_equal(window.picture, before)
        window.fire("[")
        np.testing.assert_allclose(window.picture, before, atol=1)

    window.steps = steps
    sun = prt.Lighting([prt.DirectionalLight((0.3, -0.4, -1.0), (2.0, 2.0, 2.0))])
    view(runtime, [sun], indirect, cornell.scene.camera)


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A dataset and an asset, as arguments of the command."""
    folder = tmp_path_factory.mktemp("viewer")
    scene = prt.load_scene("cornell")
    ds = prt.bake(scene, "point", 4, texels=24, rays=16, measurements=16, supersampling=2, out=folder)
    prt.method("constant").fit(ds.split("train")).export(folder / "asset")
    return [str(ds.path), str(folder / "asset")]


@pytest.mark.gl
def test_the_command_shows_the_asset_under_the_test_lightings(baked, window):
    seen = []
    window.steps = lambda window: seen.append((window.picture.max(), window.text))
    assert main(["view", *baked]) == 0
    assert seen[0][0] > 100
    assert seen[0][1].startswith("cornell, lighting 0")


@pytest.mark.gl
def test_the_command_begins_with_the_maps_it_is_given(baked, window):
    texts = []
    window.steps = lambda window: texts.append((window.text, window.picture.max()))
    path = next(iter(environment_maps().values()))
    assert main(["view", *baked, "--environment", str(path)]) == 0
    assert texts[0][0].startswith("cornell, lighting 0")
    assert texts[0][1] > 20


@pytest.mark.gl
def test_no_display_is_one_sentence(baked, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(["view", *baked]) == 2
    assert "needs a display" in capsys.readouterr().err


def test_no_tk_is_one_sentence(baked, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "tkinter", None)
    monkeypatch.delitem(sys.modules, "prt_bench.runtime.viewer")
    monkeypatch.delitem(sys.modules, "PIL.ImageTk", raising=False)
    assert main(["view", *baked]) == 2
    assert "apt-get install python3-tk" in capsys.readouterr().err


@pytest.mark.gl
def test_the_library_refuses_alike(runtime, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeUnavailable, match="needs a display"):
        view(runtime, [], runtime.lightmap(np.ones((runtime.layout.receivers, 3))), CAMERA)
