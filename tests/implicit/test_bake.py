"""Transfer on the zero set against closed forms, a mesh traced by embree, and paths that share nothing with it."""

import numpy as np
import pytest
import trimesh

from data_gen.implicit.bake import SampleIndex, bake, hit_table
from data_gen.implicit.mesh import grid_of
from data_gen.implicit.reference import follow
from data_gen.implicit.sampling import surface_points
from data_gen.implicit.scenes import SCENES, load_implicit
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError, SpecError
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.implicit.expression import distances
from prt_bench.implicit.shapes import Box, Sphere
from prt_bench.learned.transfer import open_vectors
from prt_bench.scene import Material, Mesh, Scene
from prt_bench.visibility import escaping_transfer

from .conftest import CAMERA, alone, two_spheres


def relative(found, wanted):
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def test_a_convex_body_is_open_everywhere():
    for shape in (Sphere(0.5), Box((0.3, 0.4, 0.5))):
        found = bake(alone(shape), 64, 32, 4, 16)
        wanted = np.asarray(open_vectors(found.samples.normal, 4))
        np.testing.assert_allclose(found.samples.direct, wanted, atol=2e-6)
        assert not found.samples.indirect.any()
        assert found.noise < 1e-6


def test_two_spheres_hide_what_their_meshes_hide():
    """The same directions from the same points against fine triangles, by embree."""
    scene = two_spheres()
    position = surface_points(scene, 200)
    normal = scene.normal_at(position)
    sampler = HemisphereSampler.create(256, 0)
    hits = hit_table(scene, SampleIndex(position, normal, scene), position, normal, sampler)
    balls = [trimesh.creation.icosphere(5, 0.5), trimesh.creation.icosphere(5, 0.25)]
    balls[1].apply_translation((0.2, 0.85, 0.1))
    both = trimesh.util.concatenate(balls)
    mesh = Mesh(np.array(both.vertices), np.array(both.faces), np.zeros(len(both.faces), int))
    tracer = Tracer(Scene("balls", mesh, (Material(),), CAMERA))
    directions = sampler.directions(0, normal)
    origins = np.repeat(position + 3e-3 * normal, 256, axis=0)
    missed = ~np.isfinite(tracer.intersect(origins, directions.reshape(-1, 3)).distance).reshape(-1, 256)
    found, wanted = (escaping_transfer(each, sampler, 0, normal, 5) for each in (hits == len(position) + 1, missed))
    assert np.mean((hits == len(position) + 1) != missed) < 0.01
    assert relative(found, wanted) < 0.01
    assert relative(np.asarray(open_vectors(normal, 5)), wanted) > 0.05, "something is hidden"


def test_bounces_are_those_of_paths():
    scene = two_spheres()
    baked = bake(scene, 512, 128, 3, 48)
    fresh = baked.fresh
    reference = follow(scene, fresh.position, fresh.normal, 3, 600)
    found = np.concatenate([fresh.direct[:, None], fresh.direct[:, None] + fresh.indirect], axis=1)
    noise = np.linalg.norm(reference.error) / np.linalg.norm(reference.mean)
    assert relative(found, reference.mean) < 1.3 * noise + 2 * baked.noise
    bounced = reference.mean[:, 1:] - reference.mean[:, :1]
    assert relative(fresh.indirect, bounced) < 0.5 * relative(0 * bounced, bounced), "light is reflected at all"
    assert fresh.indirect[:, 0, 0].sum() > fresh.indirect[:, 2, 0].sum(), "the large ball is red"


def test_hits_do_not_leak_through_thin_walls():
    scene = alone(Box((0.5, 0.002, 0.5)))
    position = surface_points(scene, 400)
    index = SampleIndex(position, scene.normal_at(position), scene)
    above = np.array([[x, 0.002, z] for x in np.linspace(-0.4, 0.4, 20) for z in np.linspace(-0.4, 0.4, 20)])
    assert np.all(position[index(above), 1] > 0)
    assert np.all(position[index(above * [1, -1, 1]), 1] < 0)


def test_a_mesh_becomes_its_distance_and_holes_are_closed():
    ball = trimesh.creation.icosphere(3, 0.5)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    grid = grid_of(vertices, faces, 24)
    places = np.random.default_rng(0).uniform(-0.55, 0.55, (2000, 3))
    wanted = np.linalg.norm(places, axis=1) - 0.5
    found = np.asarray(distances(grid, places))
    assert np.abs(found - wanted).max() < 0.5 * grid.cell
    keep = np.linalg.norm(vertices[faces].mean(axis=1) - [0.0, 0.5, 0.0], axis=1) > 0.15
    open_ = np.asarray(distances(grid_of(vertices, faces[keep], 24), places))
    away = np.linalg.norm(places - [0.0, 0.5, 0.0], axis=1) > 0.25
    assert np.mean(np.sign(open_[away]) == np.sign(wanted[away])) > 0.99
    with pytest.raises(SceneError, match="no inside"):
        grid_of(vertices, faces[:, ::-1], 24)
    with pytest.raises(SceneError):
        grid_of(vertices, faces, 4)


def test_shells_that_reach_into_each_other_are_one_body():
    """Within the overlap of two balls the distance is to what can be seen from outside, not to the walls inside."""
    halves = [trimesh.creation.icosphere(3, 0.4).apply_translation([x, 0.0, 0.0]) for x in (-0.2, 0.2)]
    both = trimesh.util.concatenate(halves)
    grid = grid_of(np.array(both.vertices), np.array(both.faces), 32)
    rim = np.sqrt(0.4**2 - 0.2**2)  # the circle where the balls meet is nearest to the middle of the overlap
    middle = np.array([[0.0, 0.0, 0.0], [0.05, 0.05, 0.0]])
    wanted = -np.hypot(middle[:, 0], rim - middle[:, 1])
    assert np.allclose(np.asarray(distances(grid, middle)), wanted, atol=grid.cell)


def test_shipped_scenes_are_built_and_unknown_ones_refused():
    for name in ("blend", "gyroid", "bulb"):
        scene = load_implicit(name)
        assert scene.glossy
        assert not scene.achromatic
        assert np.all(np.isfinite(scene.bounds))
    assert set(SCENES) == {"blend", "gyroid", "bulb", "suzanne"}
    with pytest.raises(SceneError, match="no implicit scene"):
        load_implicit("teapot")
    with pytest.raises(SpecError):
        bake(two_spheres(), 4)
