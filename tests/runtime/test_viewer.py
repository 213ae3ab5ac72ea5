"""The viewer's camera, and its refusal where there is no display."""

import numpy as np
import pytest

from prt_bench.errors import RuntimeUnavailable
from prt_bench.runtime.viewer import Orbit, view
from prt_bench.scene import Camera

CAMERA = Camera((1.6, 1.5, 4.0), (0.0, 0.6, 0.0), fov_y=36.0)


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


@pytest.mark.gl
def test_no_display_is_one_sentence(runtime, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeUnavailable, match="needs a display"):
        view(runtime, [], runtime.lightmap(np.ones((runtime.layout.receivers, 3))), CAMERA)
