"""Sphere tracing and sampling against closed forms."""

import numpy as np
import pytest

from data_gen.implicit.sampling import area, surface_points
from prt_bench.errors import SceneError
from prt_bench.implicit.expression import distances
from prt_bench.implicit.operations import Intersection, Scaled
from prt_bench.implicit.shapes import Box, Gyroid, Sphere, Torus
from prt_bench.implicit.tracing import crossings, trace

from .conftest import alone


def random_directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_rays_meet_a_sphere_where_the_quadratic_says():
    scene = alone(Sphere(0.7))
    origin = 3.0 * random_directions(4000)
    aim = 1.1 * random_directions(4000, 1)
    direction = aim - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    b = np.sum(origin * direction, axis=1)
    root = b**2 - np.sum(origin**2, axis=1) + 0.49
    found = trace(scene, origin, direction)
    clear = np.abs(root) > 20 * scene.tolerance
    assert np.array_equal(found.hit[clear], (root > 0)[clear])
    hit = found.hit & (root > 0.05)
    near = -b[hit] - np.sqrt(root[hit])
    assert np.abs(found.distance[hit] - near).max() < 5 * scene.tolerance
    assert 0.2 < hit.mean() < 0.9


@pytest.mark.parametrize(("shape", "size"), [(Sphere(0.7), 1e-3), (Sphere(0.7), 1e4), (Box((0.4, 0.5, 0.6)), 1.0)])
def test_no_ray_meets_the_convex_surface_that_it_left(shape, size):
    scene = alone(Scaled(shape, size))
    position = surface_points(scene, 1500)
    normal = scene.normal_at(position)
    direction = random_directions(1500)
    direction *= np.sign(np.sum(direction * normal, axis=1, keepdims=True))
    assert not trace(scene, position, direction, offset=True).hit.any()
    inward = trace(scene, position + 0.5 * size * normal, -normal)
    assert inward.hit.all()


def test_points_are_uniform_by_area():
    """On a box every face has its share, within four standard deviations of independent points; on a ball every octant."""
    half = np.array([0.2, 0.4, 0.8])
    scene = alone(Box(tuple(half)))
    points = surface_points(scene, 4000, 3)
    assert np.abs(np.asarray(distances(scene.shape, points))).max() < 1e-6 * scene.extent
    face = np.argmax(np.abs(points) / half, axis=1) * 2 + (
        points[np.arange(4000), np.argmax(np.abs(points) / half, axis=1)] > 0
    )
    areas = np.repeat([half[1] * half[2], half[0] * half[2], half[0] * half[1]], 2)
    share = areas / areas.sum()
    gap = np.abs(np.bincount(face, minlength=6) / 4000 - share)
    assert np.all(gap < 4 * np.sqrt(share / 4000))
    longest = points[face == 5]
    np.testing.assert_allclose(longest[:, :2].mean(axis=0), 0.0, atol=0.1)
    assert area(scene, 1 << 12) == pytest.approx(8 * areas.sum() / 2, rel=0.05)
    ball = surface_points(alone(Sphere(0.5)), 4000)
    octant = ((ball > 0) @ [1, 2, 4]).astype(int)
    assert np.abs(np.bincount(octant, minlength=8) / 500 - 1).max() < 0.2


def test_points_at_equal_angles_would_be_noticed():
    """What projecting uniform directions gives on a long box: the far faces get far less than their share."""
    half = np.array([0.2, 0.4, 0.8])
    d = random_directions(4000)
    points = d / np.max(np.abs(d) / half, axis=1, keepdims=True)
    ends = np.mean(np.abs(points[:, 2]) > 0.8 - 1e-9)
    share = half[0] * half[1] / (half[0] * half[1] + half[1] * half[2] + half[0] * half[2])
    assert abs(ends - share) > 4 * np.sqrt(share / 4000)


def test_a_line_crosses_a_ring_four_times():
    points = crossings(alone(Torus(0.6, 0.2)), np.array([[-3.0, 0.05, 0.01]]), np.array([[1.0, 0.0, 0.0]]))
    assert len(points) == 4
    radius = np.hypot(np.hypot(points[:, 0], points[:, 2]) - 0.6, points[:, 1])
    np.testing.assert_allclose(radius, 0.2, atol=1e-6)


def test_the_same_seed_gives_the_same_points_and_an_empty_scene_is_refused():
    scene = alone(Torus(0.6, 0.2))
    assert np.array_equal(surface_points(scene, 100, 7), surface_points(scene, 100, 7))
    assert not np.array_equal(surface_points(scene, 100, 7), surface_points(scene, 100, 8))
    void = alone(Intersection(Sphere(0.1), Gyroid(50.0, 1e-3)), box=np.array([[0.05] * 3, [0.2] * 3]))
    with pytest.raises(SceneError, match="no line crosses"):
        surface_points(void, 10)
