"""Bodies that move: probes filled by assets against the models, their light on a body against the volume in JAX, refusals."""

import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import AssetError, SceneError
from prt_bench.irradiance_volume import ProbeVolume, normals
from prt_bench.lights import Lighting, PointLight
from prt_bench.models import CoupledModel, LinearModel, NearestModel
from prt_bench.runtime import Runtime, shaders
from prt_bench.runtime.bodies import Body
from prt_bench.scene import Mesh

from .conftest import gamma_model

pytestmark = pytest.mark.gl

SHAPE = (3, 2, 4)
PROBES = 24
ALBEDO = (0.8, 0.5, 0.3)
LAMP = Lighting([PointLight((0.1, 1.6, 0.2), (5.0, 4.0, 3.0))])
CARD = Mesh(
    np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, int)
)
"""A square of side 2 that faces +z."""


def volume_in(scene, coefficients: np.ndarray | None = None) -> ProbeVolume:
    """A grid in the scene, every fifth probe in a body, with random light."""
    rng = np.random.default_rng(1)
    light = rng.normal(size=(1, PROBES, 9, 3)) + 3.0 * (np.arange(9) == 0)[:, None]
    low, high = (jnp.asarray(corner) for corner in scene.bounds)
    return ProbeVolume(
        low, high, jnp.asarray(np.arange(PROBES) % 5 == 2), jnp.asarray(light if coefficients is None else coefficients),
        SHAPE,
    )  # fmt: skip


def posed(angles: tuple[float, float], size: float, place: tuple[float, float, float]) -> np.ndarray:
    (a, b), pose = angles, np.eye(4)
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    pose[:3, :3], pose[:3, 3] = size * about_y @ about_x, place
    return pose


def models(measurements: int) -> dict[str, object]:
    """A model of each kind that observes direct light, with random weights, for the receivers of the probes."""
    rng, receivers, basis = np.random.default_rng(0), PROBES * len(normals()[0]), 6
    directions = np.abs(rng.normal(size=(basis, measurements)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def random(*shape: int) -> jnp.ndarray:
        return jnp.asarray(rng.normal(size=shape))

    linear = LinearModel(random(receivers, basis), random(3, basis, measurements + 1))
    coupled = CoupledModel(random(receivers, 3, basis), random(basis, 3 * measurements + 1))
    nearest = NearestModel(random(receivers, basis), jnp.asarray(directions))
    return {"linear": linear, "coupled": coupled, "nearest": nearest, "gamma": gamma_model(linear)}


@pytest.mark.parametrize("kind", ["linear", "coupled", "nearest", "gamma"])
def test_predicted_probes_are_those_of_the_model(runtime, cornell, export, kind):
    asset = export(models(runtime.measurement.count)[kind])
    x = np.abs(np.random.default_rng(2).normal(size=(runtime.measurement.count, 3))).astype(np.float32)
    found = runtime.probes(volume_in(cornell.scene), asset).predict(x)
    model = asset.model()
    received = np.asarray(model.reconstruct(model.transfer(jnp.asarray(x[None]))))[0].reshape(PROBES, -1, 3)
    expected = np.einsum("kj,pjc->pkc", normals()[1], received)
    assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize(
    "pose",
    [
        posed((0.0, 0.0), 0.5, (0.0, 1.0, 0.0)),
        posed((0.7, -0.3), 0.4, (0.3, 1.2, 0.2)),
        posed((-0.5, -1.0), 0.6, (-0.1, 0.8, 0.4)),
    ],
)
def test_a_body_receives_what_the_volume_says_where_it_is(runtime, cornell, pose):
    """At every pixel of a card: albedo / π times the irradiance that JAX finds at the place seen there."""
    volume = volume_in(cornell.scene)
    body = runtime.body(CARD, ALBEDO, runtime.probes(volume))
    body.move(pose)
    dark = runtime.lightmap(np.zeros((len(cornell.points), 3)))
    frame = runtime.frame(LAMP, dark, direct=False, bodies=[body])
    assert not runtime.frame(LAMP, dark, direct=False).any()
    rows, columns = np.nonzero(frame.any(axis=2))
    assert len(rows) > 200
    width, height = runtime.size
    screen = np.stack([2 * (columns + 0.5) / width - 1, 1 - 2 * (rows + 0.5) / height], axis=1)
    near, far = (
        np.column_stack([screen, np.full(len(rows), depth), np.ones(len(rows))]) @ np.linalg.inv(runtime.camera).T
        for depth in (0.0, 1.0)
    )
    near, far = near[:, :3] / near[:, 3:], far[:, :3] / far[:, 3:]
    normal = pose[:3, 2] / np.linalg.norm(pose[:3, 2])
    along = (pose[:3, 3] - near) @ normal / ((far - near) @ normal)
    place = near + along[:, None] * (far - near)
    light = volume.irradiance(jnp.asarray(place), jnp.tile(jnp.asarray(normal), (len(place), 1)))[0]
    expected = np.asarray(light) * np.array(ALBEDO) / np.pi
    found = frame[rows, columns]
    assert np.abs(found - expected).max() <= 1e-3 * np.abs(expected).max()
    assert np.abs(expected).std(axis=0).min() > 1e-2  # it does change over the card


def test_direct_light_on_a_body_has_the_scenes_shadows(runtime, cornell):
    body = runtime.body(CARD, ALBEDO, runtime.probes(volume_in(cornell.scene)))
    body.move(posed((0.0, 0.0), 0.02, (0.1, 1.6, -0.3)))
    plain = runtime.frame(LAMP)
    lit = runtime.frame(LAMP, bodies=[body])
    changed = np.abs(lit - plain).max(axis=2) > 1e-4
    # 0.5 m straight before the card: I / r² on its middle.
    expected = np.array([5.0, 4.0, 3.0]) / 0.25 * np.array(ALBEDO) / np.pi
    np.testing.assert_allclose(lit[changed].max(axis=0), expected, rtol=0.02)
    above = Lighting([PointLight((0.1, 5.0, 0.2), (5.0, 4.0, 3.0))])
    body.move(posed((0.0, -1.5), 0.3, (0.0, 1.0, 0.4)))
    assert np.any(runtime.frame(LAMP, bodies=[body]) != plain)  # it is in sight, and lit from within the room
    assert np.all(runtime.frame(above, bodies=[body]) <= runtime.frame(above))


def test_what_stands_before_a_body_hides_it(runtime, cornell):
    body = runtime.body(CARD, ALBEDO, runtime.probes(volume_in(cornell.scene)))
    low, _ = cornell.scene.bounds
    body.move(posed((0.0, 0.0), 0.3, (0.0, 1.0, low[2] - 0.5)))  # beyond the back wall
    np.testing.assert_array_equal(runtime.frame(LAMP, bodies=[body]), runtime.frame(LAMP))
    body.move(posed((np.pi, 0.0), 0.3, (0.0, 1.0, 0.5)))  # its back
    np.testing.assert_array_equal(runtime.frame(LAMP, bodies=[body]), runtime.frame(LAMP))


def test_a_frame_without_bodies_compiles_nothing_of_them(cornell, monkeypatch):
    named, sound = [], shaders.source
    monkeypatch.setattr(shaders, "source", lambda name, *rest: named.append(sound(name, *rest)) or named[-1])
    bare = Runtime(cornell, size=(32, 24), shadow_resolution=256)
    bare.frame(LAMP, bare.lightmap(np.ones((len(cornell.points), 3))))
    assert len(named) > 4
    assert not [text for text in named if "probe" in text.lower() or "mat4 pose" in text]
    named.clear()
    bare.body(CARD, ALBEDO, bare.probes(volume_in(cornell.scene)))
    assert [text for text in named if "probe_irradiance" in text]


def test_what_lights_no_body_is_refused(runtime, cornell, export):
    volume = volume_in(cornell.scene)
    two = volume_in(cornell.scene, np.zeros((2, PROBES, 9, 3)))
    with pytest.raises(AssetError, match="2 lightings"):
        runtime.probes(two)
    model = models(runtime.measurement.count)["linear"]
    fewer = LinearModel(model.basis[:-1], model.weights)  # pyright: ignore
    with pytest.raises(AssetError, match="fit it to their own dataset"):
        runtime.probes(volume, export(fewer))
    with pytest.raises(AssetError, match="no asset"):
        runtime.probes(volume).predict(np.zeros((runtime.measurement.count, 3)))
    light = runtime.probes(volume)
    with pytest.raises(SceneError, match="no faces"):
        runtime.body(Mesh(CARD.vertices, CARD.faces[:0], CARD.material[:0]), ALBEDO, light)
    body: Body = runtime.body(CARD, ALBEDO, light)
    for bad in (np.eye(3), np.diag([1.0, 2.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan)):
        with pytest.raises(SceneError, match="pose"):
            body.move(bad)
