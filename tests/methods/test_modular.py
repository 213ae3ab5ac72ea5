"""One block of modular transfer: a box lit by closed forms, a room whose light it has never seen, faces that are not there."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.bake import bake
from data_gen.levels import scene_of
from data_gen.scenes import load_scene
from prt_bench.modular.block import Box, missing_faces, observation, on_faces, received, shares
from prt_bench.modular.cube import FACES, sample_points
from prt_bench.modular.level import Level
from prt_bench.points import SurfacePoints

RNG = np.random.default_rng(0)
LONG = Box(np.array([1.0, -2.0, 0.0]), np.array([4.0, 1.0, 2.0]))


def points(position, normal):
    count = len(position)
    return SurfacePoints(
        position, normal, np.full((count, 3), 0.5), np.zeros(count, int), np.full((count, 3), 1.0 / 3.0)
    )


def test_within_a_box_of_any_shape_even_light_arrives_evenly():
    normal = RNG.normal(size=(50, 3))
    where = points(LONG.low + LONG.extent * RNG.uniform(size=(50, 3)), normal / np.linalg.norm(normal, axis=1)[:, None])
    np.testing.assert_allclose(received(LONG, where, np.ones((FACES * 64, 1)), 8), 1.0, atol=1e-12)


def test_what_a_wall_of_a_long_box_sends_arrives_as_its_form_factor_says():
    """From a square at distance d to a parallel element on its axis: 2/π · 2 a/√(1 + a²) · atan(a/√(1 + a²)), a = s/(2 d)."""
    box = Box(np.zeros(3), np.array([3.0, 1.0, 1.0]))
    sent = np.repeat(np.eye(FACES)[:, :1], 16 * 16, axis=0)  # the face +x
    found = received(box, points(np.array([[0.0, 0.5, 0.5]]), np.array([[1.0, 0.0, 0.0]])), sent, 16, 64)
    a = 0.5 / 3.0
    leg = np.sqrt(1.0 + a * a)
    assert found[0, 0] == pytest.approx(4.0 / np.pi * (a / leg) * np.arctan(a / leg), rel=0.02)


def test_surfaces_are_read_by_the_faces_that_they_are_parallel_to():
    position, normal = sample_points(8)
    corners = LONG.low + LONG.extent * (position + 0.5)
    seen = observation(LONG, points(corners, normal), 8)
    np.testing.assert_allclose(seen.toarray(), np.eye(len(position)), atol=1e-12)
    slanted = np.array([[0.6, 0.0, -0.8]])
    np.testing.assert_allclose(shares(slanted), [[0.0, 0.36, 0.0, 0.0, 0.64, 0.0]], atol=1e-12)
    assert observation(LONG, points(LONG.low[None] + 0.5, slanted), 8).sum() == pytest.approx(1.0)


def test_faces_without_points_take_what_is_near():
    position, normal = sample_points(4)
    some = normal[:, 1] == 0
    seen = observation(Box(np.full(3, -0.5), np.ones(3)), points(position[some], normal[some]), 4)
    values = np.where(normal[some][:, :1] > 0, 0.2, 0.8)
    found = on_faces(seen, values).reshape(FACES, 16)
    np.testing.assert_allclose(found[0], 0.8)  # +x faces −x
    np.testing.assert_allclose(found[1], 0.2)
    np.testing.assert_allclose(found[2], values.mean())


def test_a_room_without_a_wall_is_a_cube_without_a_face():
    closed = scene_of(Level(((0, 0),)))
    assert missing_faces(Box.around(closed.bounds), closed.mesh) == ()
    mesh = closed.mesh
    kept = mesh.normals[:, 2] > -0.5
    opened = replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])
    assert missing_faces(Box.around(closed.bounds), opened) == (4,)
    cornell = load_scene("cornell")
    assert missing_faces(Box.around(cornell.bounds), cornell.mesh) == (4,)
    ball = closed.mesh.normals[:, 1] > 0.5
    floor = replace(mesh, faces=mesh.faces[ball], material=mesh.material[ball])
    assert missing_faces(Box.around(closed.bounds), floor) == ()


@pytest.fixture(scope="module")
def room():
    """A closed room of one block, 3 m wide, grey."""
    scene = scene_of(Level(((0, 0),)))
    return bake(scene, scenario="point", lightings=16, texels=24, rays=64, measurements=96)


def test_even_light_in_a_furnace_grows_by_every_bounce(room):
    """x = 1 everywhere: ρ + ρ² + … after as many bounces as the bake has."""
    model = prt.method("modular").fit(room)
    lit = jnp.ones((1, len(room.measurement_points), 1))
    found = model.reconstruct(model.transfer(lit))
    albedo, bounces = 0.7, room.transport.bounces
    ratio = np.asarray(found) / sum(albedo**k for k in range(1, bounces + 1))
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 0.05  # few functions leave corners uneven


def test_a_room_is_lit_as_the_operator_lights_it_without_a_lighting_seen(room):
    test = room.split("test")
    wanted = np.asarray(test.indirect, float)

    def error(name: str) -> float:
        found = np.asarray(prt.method(name).fit(room.split("train")).predict(test))
        return float(np.mean(np.linalg.norm(found - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))))

    assert error("modular") < 0.15 < 0.5 * error("mean")


def test_light_is_not_looked_at(room):
    dark = SimpleNamespace(
        **{name: getattr(room, name) for name in ("transport", "measurement_points")},
        measured=np.zeros_like(room.measured),
        indirect=np.zeros_like(room.indirect),
    )
    fits = [prt.method("modular").fit(ds) for ds in (room, dark)]
    np.testing.assert_array_equal(fits[0].weights, fits[1].weights)
