"""Whole frames: an independent shading of a simple scene, darkness, seams, sky, back faces, tone map, files."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from data_gen.geometry import Part, assemble, quad, with_both_sides
from prt_bench.environment import EnvironmentMap
from prt_bench.images import exposure_for, tone_map, write_exr, write_png
from prt_bench.lights import DirectionalLight, EnvironmentLight, Lighting, PointLight
from prt_bench.runtime import Runtime
from prt_bench.runtime.indirect import PlainLightmap
from prt_bench.scene import Camera, Material, Scene

from .conftest import linear_model, quad_dataset

pytestmark = pytest.mark.gl

LAMP = Lighting([PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0))])
DARKNESS = Lighting([])


def floor_scene(material: Material, uv: np.ndarray | None = None, camera: Camera | None = None) -> Scene:
    """A square floor, 4 m a side, seen from above at an angle."""
    part = quad([(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], 0)
    mesh = assemble([Part(part.vertices, part.faces, 0, uv)])
    return Scene("floor", mesh, (material,), camera or Camera((0.5, 2.0, 3.0), (0.0, 0.0, 0.0), fov_y=50.0))


def camera_rays(camera: Camera, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Eye and direction of every pixel's centre, top row first, by the pinhole model."""
    width, height = size
    eye = np.array(camera.position, float)
    forward = np.array(camera.target) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    tangent = np.tan(np.radians(camera.fov_y) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * tangent * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * tangent
    direction = forward + x[None, :, None] * right + y[:, None, None] * up
    return eye, direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def on_floor(scene: Scene, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel meets y = 0, and whether that is on the floor, away from its edge."""
    eye, direction = camera_rays(scene.camera, size)
    position = eye - direction * (eye[1] / direction[..., 1:2])
    return position, (direction[..., 1] < 0) & (np.abs(position[..., [0, 2]]).max(axis=-1) < 1.95)


def test_frame_is_the_rendering_equation_of_a_lit_floor():
    albedo, indirect = np.array([0.8, 0.5, 0.2]), np.array([0.1, 0.2, 0.3])
    scene, size = floor_scene(Material("floor", tuple(albedo))), (96, 64)
    runtime = Runtime(quad_dataset(scene), size=size)
    lamp, intensity = np.array([0.3, 0.7, -0.4]), np.array([2.0, 3.0, 4.0])
    ambient = runtime.lightmap(np.tile(indirect, (runtime.layout.receivers, 1)))
    frame = runtime.frame(Lighting([PointLight(lamp, intensity, 0.1)]), ambient)
    position, covered = on_floor(scene, size)
    offset = lamp - position
    squared = np.sum(offset**2, axis=-1, keepdims=True)
    direct = intensity * (lamp[1] / np.sqrt(squared)) / (squared + 0.1**2)
    np.testing.assert_allclose(frame[covered], (albedo / np.pi * (direct + indirect))[covered], rtol=1e-4)
    assert covered.mean() > 0.3


def test_albedo_images_are_looked_up_like_the_bake_does():
    image = np.random.default_rng(0).random((4, 4, 3))
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    scene, size = floor_scene(Material("tiles", (0.9, 0.9, 0.9), image), uv), (96, 64)
    runtime = Runtime(quad_dataset(scene), size=size)
    light = runtime.lightmap(np.full((runtime.layout.receivers, 3), np.pi))
    frame = runtime.frame(DARKNESS, light, direct=False)
    position, covered = on_floor(scene, size)
    at = position[covered]
    # The floor's plane as one triangle that spans it: barycentrics of (x, z) on corners (−2, 2), (2, 2), (−2, −2).
    u, v = (at[:, 0] + 2) / 4, (2 - at[:, 2]) / 4
    upper = v > u
    barycentric = np.where(upper[:, None], np.stack([1 - v, u, v - u], 1), np.stack([1 - u, u - v, v], 1))
    wanted = scene.albedo_at(upper.astype(int), barycentric)
    inside = (np.abs(u - 0.5) < 0.37) & (np.abs(v - 0.5) < 0.37)
    np.testing.assert_allclose(frame[covered][inside], wanted[inside], atol=5e-3)


def test_darkness_is_black(runtime, cornell, export):
    loaded = runtime.load(export(linear_model(cornell, 8)))
    for light in (DARKNESS, Lighting([PointLight((0, 1, 0), (0, 0, 0))])):
        assert not runtime.frame(light, loaded).any()
        assert not runtime.measure(light).any()


def test_no_seams_between_charts(runtime):
    """A constant lightmap lights every covered pixel exactly alike, up to the borders of the charts."""
    ones = runtime.lightmap(np.ones((runtime.layout.receivers, 3)))
    frame = runtime.frame(DARKNESS, ones, direct=False) * np.pi
    covered = frame.max(axis=-1) > 0
    albedo = np.array([material.albedo for material in runtime.scene.materials])
    nearest = np.abs(frame[covered][:, None] - albedo).max(axis=-1).min(axis=1)
    assert covered.mean() > 0.4
    assert nearest.max() < 1e-6


def test_an_asset_lights_like_its_lightmap(runtime, cornell, export):
    loaded = runtime.load(export(linear_model(cornell, 7)))
    frame = runtime.frame(LAMP, loaded, direct=False)
    lightmap = runtime.lightmap(loaded.predict(runtime.measure(LAMP)))
    np.testing.assert_allclose(
        frame, runtime.frame(LAMP, lightmap, direct=False), rtol=1e-4, atol=1e-5 * np.abs(frame).max()
    )


def test_direct_and_indirect_add_up(runtime, cornell, export):
    loaded = runtime.load(export(linear_model(cornell, 4)))
    both = runtime.frame(LAMP, loaded)
    parts = runtime.frame(LAMP) + runtime.frame(LAMP, loaded, direct=False)
    np.testing.assert_allclose(both, parts, rtol=1e-4, atol=1e-5 * np.abs(both).max())
    with pytest.raises(ValueError, match="direct light, indirect light, or both"):
        runtime.frame(LAMP, direct=False)


def test_a_grey_lightmap_lights_all_channels(runtime):
    grey = PlainLightmap(runtime, np.ones((runtime.layout.receivers, 1)))
    colour = runtime.lightmap(np.ones((runtime.layout.receivers, 3)))
    frames = [runtime.frame(DARKNESS, each, direct=False) for each in (grey, colour)]
    np.testing.assert_array_equal(*frames)


def test_sky_shows_the_map_where_nothing_is():
    rows = np.linspace(1.0, 3.0, 64)[:, None, None] * np.array([1.0, 2.0, 3.0])
    columns = 1.0 + np.arange(128)[None, :, None] / 128
    radiance = (rows * columns).astype(np.float32)
    turn = np.array([0.2, 0.7, -0.1])
    camera = Camera((0.5, 2.0, 3.0), (0.3, 2.5, 0.0), fov_y=60.0)
    scene, size = floor_scene(Material(), camera=camera), (48, 32)
    runtime = Runtime(quad_dataset(scene), size=size)
    frame = runtime.frame(Lighting([EnvironmentLight(EnvironmentMap("ramp", radiance), turn)]))
    _, direction = camera_rays(camera, size)
    # Rodrigues' formula for the inverse rotation, into the map's frame
    angle, axis = -np.linalg.norm(turn), turn / np.linalg.norm(turn)
    along = (direction @ axis)[..., None] * axis
    d = along + np.cos(angle) * (direction - along) + np.sin(angle) * np.cross(axis, direction)
    u = np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi) + 0.5
    v = np.arccos(d[..., 1]) / np.pi
    smooth = 1.0 + np.clip(v * 64 - 0.5, 0, 63) / 63 * 2.0
    wanted = (smooth * (1.0 + (u * 128 - 0.5) / 128))[..., None] * [1.0, 2.0, 3.0]
    sky = direction[..., 1] > 0.02
    away_from_the_join = np.abs(u - 0.5) < 0.48
    assert (sky & away_from_the_join).mean() > 0.3
    np.testing.assert_allclose(frame[sky & away_from_the_join], wanted[sky & away_from_the_join], rtol=2e-3)


def test_backs_of_one_sided_surfaces_are_black_and_hide_the_sky():
    camera = Camera((0.0, -3.0, 0.01), (0.0, 0.0, 0.0), fov_y=30.0)
    runtime = Runtime(quad_dataset(floor_scene(Material(), camera=camera)), size=(16, 16))
    sky = Lighting([EnvironmentLight(np.ones((4, 8, 3))), DirectionalLight((0, 1, 0), (1, 1, 1))])
    assert not runtime.frame(sky).any()


@pytest.mark.parametrize("height", [2.0, 0.3, -0.3])
def test_two_sided_surfaces_show_a_lit_side_from_anywhere(height):
    material = Material("leaf", two_sided=True)
    part = quad([(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], 0)
    mesh = with_both_sides(assemble([part]), (material,))
    camera = Camera((0.5, height, 3.0), (0.0, 0.0, 0.0), fov_y=50.0)
    scene, size = Scene("leaf", mesh, (material,), camera), (96, 64)
    runtime = Runtime(quad_dataset(scene), size=size)
    light = runtime.lightmap(np.ones((runtime.layout.receivers, 3)))
    frame = runtime.frame(DARKNESS, light, direct=False)
    eye, direction = camera_rays(camera, size)
    position = eye - direction * (eye[1] / direction[..., 1:2])
    covered = (direction[..., 1] * height < 0) & (np.abs(position[..., [0, 2]]).max(axis=-1) < 1.9)
    assert covered.any()
    np.testing.assert_allclose(frame[covered], 0.5 / np.pi, rtol=1e-5)


def test_tone_map_is_the_same_on_both_processors(runtime):
    exposure = exposure_for(runtime.frame(LAMP))
    on_gpu = runtime.picture(LAMP, exposure=exposure)
    on_cpu = tone_map(runtime.frame(LAMP), exposure)
    assert np.abs(on_gpu.astype(int) - on_cpu).max() <= 1
    assert on_gpu.max() == 255
    assert (on_gpu > 0).mean() > 0.2


def test_exposure_puts_a_quantile_at_white():
    radiance = np.linspace(0.0, 8.0, 1001)[None, :, None] * np.ones((2, 1, 3))
    exposure = exposure_for(radiance, quantile=0.5)
    assert np.isclose(2.0**exposure * 4.0, 1.0, rtol=1e-2)
    assert exposure_for(np.zeros((2, 2, 3))) == 0.0


def test_files_hold_what_was_written(tmp_path):
    radiance = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32) * 40
    write_exr(tmp_path / "frame.exr", radiance)
    with OpenEXR.File(str(tmp_path / "frame.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, radiance)
    write_png(tmp_path / "frame.png", tone_map(radiance, -5.0))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "frame.png")), tone_map(radiance, -5.0))
