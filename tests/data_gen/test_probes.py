"""Probes: closed forms, brute force, linearity, and methods that predict them."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.reference import indirect_irradiance
from prt_bench.errors import LightError, RuntimeUnavailable, SpecError
from prt_bench.irradiance_volume import ORDER, ProbeVolume, normals, places
from prt_bench.runtime import Runtime
from prt_bench.scene import Mesh
from prt_bench.spherical.harmonics import bands, evaluate

SMALL: dict[str, Any] = {
    "scenario": "point",
    "lightings": 40,
    "texels": 48,
    "rays": 64,
    "measurements": 48,
    "supersampling": 1,
}
AXES = np.concatenate([np.eye(3), -np.eye(3)])
LAMP = prt.Lighting([prt.PointLight([0.0, 1.6, 0.2], (10.0, 8.0, 6.0))])


@pytest.fixture(scope="module")
def cornell(tmp_path_factory: pytest.TempPathFactory) -> prt.LightingDataset:
    return prt.bake(prt.load_scene("cornell"), **SMALL, out=tmp_path_factory.mktemp("probes"))


@pytest.fixture(scope="module")
def aired(cornell: prt.LightingDataset) -> tuple[Any, prt.LightingDataset]:
    """Probes of the room, and their dataset."""
    probes = prt.probes(cornell, (3, 3, 3), rays=32)
    return probes, probes.dataset(cornell)


def test_uniform_light_and_a_distant_lamp_have_their_closed_forms() -> None:
    """White light from everywhere: one coefficient. Light from one direction d: π, 2π/3 and π/4 times Y(d)."""
    facing, matrix = normals()
    flat = matrix @ np.full(len(facing), 3.0)
    np.testing.assert_allclose(flat, [3.0 * np.sqrt(4.0 * np.pi), *[0.0] * 8], atol=1e-12)
    towards = np.array([0.36, 0.48, 0.8])
    found = matrix @ np.maximum(facing @ towards, 0.0)
    convolved = np.array([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0])[bands(ORDER)] * np.asarray(evaluate(towards, ORDER))
    np.testing.assert_allclose(found, convolved, atol=0.03)
    assert np.linalg.norm(found - convolved) < 0.03 * np.linalg.norm(convolved)


def test_a_closed_white_room_is_as_bright_everywhere_and_whatever_faces(tmp_path: Path) -> None:
    """ρ E / (1 − ρ) for a lamp in the middle of a sphere, whose wall receives E = I / r²."""
    ds = prt.bake(prt.load_scene("furnace"), **{**SMALL, "lightings": 1}, out=tmp_path)
    centre = ds.scene.bounds.mean(axis=0)
    radius = np.linalg.norm(ds.scene.mesh.vertices - centre, axis=1).mean()
    albedo = ds.scene.largest_albedo
    volume = prt.probes(ds, (3, 3, 3), rays=32).light([prt.Lighting([prt.PointLight(centre, (2.0, 2.0, 2.0))])])
    place = centre + 0.3 * radius * np.random.default_rng(0).uniform(-1, 1, (6, 3))
    expected = albedo / (1.0 - albedo) * 2.0 / radius**2
    np.testing.assert_allclose(volume.irradiance(jnp.asarray(place), jnp.asarray(AXES)), expected, rtol=0.02)
    beyond = np.linalg.norm(places(*ds.scene.bounds, (3, 3, 3)) - centre, axis=1) > 1.01 * radius
    np.testing.assert_array_equal(volume.buried, beyond)
    assert beyond.sum() == 8


def test_probes_receive_what_paths_bring(cornell: prt.LightingDataset) -> None:
    volume = prt.probes(cornell, (3, 3, 3), rays=256).light([LAMP])
    free = np.flatnonzero(~np.asarray(volume.buried))[::3]
    place = np.repeat(places(*cornell.scene.bounds, (3, 3, 3))[free], 6, axis=0)
    facing = np.tile(AXES, (len(free), 1))
    found = np.asarray(volume.irradiance(jnp.asarray(place), jnp.asarray(facing)))[0]
    expected = indirect_irradiance(cornell.scene, place, facing, LAMP, 2048).mean
    assert np.linalg.norm(found - expected) < 0.06 * np.linalg.norm(expected)
    assert abs(found.mean() / expected.mean() - 1.0) < 0.02


def test_light_adds_up(cornell: prt.LightingDataset) -> None:
    one, other = (lighting.lights for lighting in cornell.split("test").lightings[:2])
    volume = prt.probes(cornell, (2, 2, 2), rays=16).light(
        [prt.Lighting(part) for part in (one, other, (*one, *other))]
    )
    parts = volume.coefficients
    np.testing.assert_allclose(parts[2], parts[0] + parts[1], rtol=1e-4, atol=1e-5 * float(jnp.abs(parts).max()))


def test_a_method_predicts_probes_from_the_light_it_measures(
    cornell: prt.LightingDataset, aired: tuple[Any, prt.LightingDataset]
) -> None:
    probes, ds = aired
    test = ds.split("test")
    np.testing.assert_array_equal(test.measured, cornell.split("test").measured)
    assert test.indirect.shape[1] == 27 * len(normals()[0])
    truth = probes.volume(test.indirect).coefficients
    np.testing.assert_allclose(truth, probes.light(test.lightings).coefficients, rtol=1e-5, atol=1e-6)
    train = ds.split("train")

    def error(method: Any, split: prt.LightingDataset) -> float:
        predicted, light = (
            np.asarray(probes.volume(np.asarray(values)).coefficients).reshape(len(split), -1)
            for values in (method.fit(train).predict(split), split.indirect)
        )
        apart, whole = (np.linalg.norm(part, axis=1) for part in (predicted - light, light))
        return float(np.sqrt(np.mean((apart / whole) ** 2)))

    close, linear, mean = (
        prt.method("svd-ridge", basis=24, ridge=1e-6),
        prt.method("svd-ridge", basis=16),
        prt.method("mean"),
    )
    assert error(close, train) < 0.35 < 0.7 < error(mean, train)
    assert error(linear, test) < 0.95 * error(mean, test)


def test_interpolation_is_exact_for_linear_light_and_leaves_buried_probes_out() -> None:
    shape, low, high = (3, 2, 4), np.zeros(3), np.array([3.0, 2.0, 4.0])
    position = places(low, high, shape)
    slope = np.array([0.5, -0.25, 0.125])
    constant = (2.0 + position @ slope) * np.sqrt(4.0 * np.pi)
    coefficients = np.zeros((1, 24, 9, 1))
    coefficients[0, :, 0, 0] = constant
    bright = np.zeros(24, bool)
    volume = ProbeVolume(*(jnp.asarray(part) for part in (low, high, bright, coefficients)), shape)
    inside = np.random.default_rng(0).uniform([0.5, 0.5, 0.5], [2.5, 1.5, 3.5], (20, 3))
    up = np.tile([0.0, 0.0, 1.0], (20, 1))
    np.testing.assert_allclose(volume.irradiance(inside, up)[0, :, 0], 2.0 + inside @ slope, rtol=1e-6)
    outside = np.array([[-9.0, 0.5, 0.5]])
    np.testing.assert_allclose(volume.irradiance(outside, up[:1]), volume.irradiance(np.full((1, 3), 0.5), up[:1]))
    some = np.arange(24) % 5 == 0
    spoilt = np.where(some[:, None, None], 1e9, coefficients)
    assert (
        ProbeVolume(*(jnp.asarray(part) for part in (low, high, some, spoilt)), shape).irradiance(inside, up).max()
        < 9.0
    )
    dark = ProbeVolume(*(jnp.asarray(part) for part in (low, high, ~bright, coefficients)), shape)
    assert not dark.irradiance(inside, up).any()


def test_probes_in_the_blocks_are_buried_and_workers_change_nothing(cornell: prt.LightingDataset) -> None:
    one, two = (prt.probes(cornell, (6, 6, 6), rays=8, workers=workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.transport.receiver_hits, two.transport.receiver_hits)
    position = places(*cornell.scene.bounds, (6, 6, 6))
    assert 0 < one.buried.sum() < 40
    assert position[one.buried][:, 1].max() < 1.4  # the taller block is lower than that


def test_bad_grids_and_lights_in_bodies_are_refused(cornell: prt.LightingDataset) -> None:
    with pytest.raises(SpecError, match="has none"):
        prt.probes(cornell, (0, 2, 2))
    with pytest.raises(SpecError, match="rays is 7"):
        prt.probes(cornell, (2, 2, 2), rays=7)
    box = cornell.scene.mesh.vertices[cornell.scene.mesh.faces[-6:]].reshape(-1, 3).mean(axis=0)
    with pytest.raises(LightError, match="inside"):
        prt.probes(cornell, (1, 1, 1), rays=2).light([prt.Lighting([prt.PointLight(box, (1.0, 1.0, 1.0))])])


def test_translucent_bodies_light_the_air(tmp_path: Path) -> None:
    """Light that left a body reaches probes: more than the walls alone send."""
    ds = prt.bake(prt.load_scene("candle"), **{**SMALL, "lightings": 1, "texels": 32, "rays": 32}, out=tmp_path)
    probes = prt.probes(ds, (2, 2, 2), rays=32)
    lit = probes.light(ds.split("test").lightings[:4]).coefficients[:, :, 0]
    assert np.all(np.isfinite(lit))
    assert float(lit.mean()) > 0


@pytest.mark.gl
def test_a_fitted_asset_lights_a_body_as_its_model_does(
    cornell: prt.LightingDataset, aired: tuple[Any, prt.LightingDataset], tmp_path: Path
) -> None:
    """From traced probes to a frame: the light that the runtime measures predicts what a body in it receives."""
    try:
        runtime = Runtime(cornell, size=(48, 36), shadow_resolution=512)
    except RuntimeUnavailable as error:
        pytest.skip(str(error))
    probes, lit = aired
    asset = prt.method("svd-ridge", basis=6).fit(lit.split("train")).export(tmp_path / "probes")
    room = prt.method("svd-ridge", basis=6).fit(cornell.split("train")).export(tmp_path / "room")
    test, model = lit.split("test"), asset.model()
    light = runtime.probes(probes.volume(test.indirect[:1]), asset)
    card = np.array([[-0.3, 0.9, 0.2], [0.3, 0.9, 0.2], [0.3, 1.5, 0.2], [-0.3, 1.5, 0.2]])
    body = runtime.body(Mesh(card, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, int)), (0.8, 0.5, 0.3), light)
    with_body, without = (
        runtime.frame(test.lightings[0], runtime.load(room), bodies=bodies) for bodies in ([body], [])
    )
    assert np.all(np.isfinite(with_body))
    assert 0.01 < np.mean(np.any(with_body != without, axis=2)) < 0.5
    shown = light.read()
    for found, x in (
        (shown, runtime.measure(test.lightings[0])),
        (light.predict(np.asarray(test.measured[0])), np.asarray(test.measured[0])),
    ):
        received = model.reconstruct(model.transfer(jnp.asarray(x[None], jnp.float32)))
        expected = np.asarray(probes.volume(np.asarray(received)).coefficients[0])
        assert np.abs(found - expected).max() <= 1e-3 * np.abs(expected).max()
