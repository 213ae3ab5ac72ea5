"""Measurement points: blue noise, in the right places, in groups that do not reach through walls."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from data_gen.geometry import assemble, box, quad, rotation_about
from data_gen.sampling import measurement_points, poisson_radius, random_points, sample_elimination
from data_gen.scenes import load_scene
from prt_bench.errors import SceneError
from prt_bench.scene import Camera, Material, Scene


def relative_spacing(position, area):
    """Least distance between points over the largest possible one."""
    nearest = cKDTree(position).query(position, 2)[0][:, 1]
    return nearest.min() / (2.0 * poisson_radius(area, len(position)))


def test_poisson_radius_is_that_of_hexagonal_packing():
    rows, columns = 40, 40
    x = np.arange(columns) + 0.5 * (np.arange(rows)[:, None] % 2)
    y = np.sqrt(0.75) * np.broadcast_to(np.arange(rows)[:, None], x.shape)
    area = columns * rows * np.sqrt(0.75)
    assert relative_spacing(np.stack([x, y, 0 * x], -1).reshape(-1, 3), area) == pytest.approx(1.0)


def test_elimination_leaves_blue_noise():
    points = np.random.default_rng(0).random((2500, 3)) * (1, 1, 0)
    kept = sample_elimination(points, 500, 1.0)
    assert len(np.unique(kept)) == 500
    assert relative_spacing(points[kept], 1.0) > 0.65
    assert relative_spacing(points[:500], 1.0) < 0.2


def test_elimination_removes_the_crowded_points():
    """A greedy reference that recomputes every weight from scratch agrees."""
    points = np.random.default_rng(1).random((60, 3)) * (1, 1, 0)
    radius = poisson_radius(1.0, 20)
    least = radius * (1 - (20 / 60) ** 1.5) * 0.65
    alive = list(range(60))
    while len(alive) > 20:
        distance = np.linalg.norm(points[alive][:, None] - points[alive][None], axis=-1)
        weight = (1 - np.minimum(np.maximum(distance, 2 * least), 2 * radius) / (2 * radius)) ** 8
        np.fill_diagonal(weight, 0)
        alive.pop(int(np.argmax(weight.sum(axis=1))))
    assert sample_elimination(points, 20, 1.0).tolist() == alive


def test_random_points_are_uniform_in_area():
    points = random_points(load_scene("cornell"), 20_000, 0)
    on_floor = (points.position[:, 1] == 0) & (points.normal[:, 1] > 0)
    assert on_floor.mean() == pytest.approx(4.0 / load_scene("cornell").mesh.areas.sum(), rel=0.02)
    assert np.histogram(points.position[on_floor, 0], 4, (-1, 1))[0].std() < 0.1 * on_floor.sum() / 4


@pytest.fixture(scope="module")
def cornell():
    scene = load_scene("cornell")
    return scene, *measurement_points(scene, 256, 8, 0)


def test_points_are_blue_noise_and_reproducible(cornell):
    scene, points, dense, groups = cornell
    again = measurement_points(scene, 256, 8, 0)
    other = measurement_points(scene, 256, 1, 1)[0]
    assert len(points) == 256
    assert len(dense) == 2048
    assert groups.shape == (256, 8)
    assert np.array_equal(points.position, again[0].position)
    assert np.array_equal(groups, again[2])
    assert not np.array_equal(points.position, other.position)
    for kept in (points, dense):
        assert relative_spacing(kept.position, scene.mesh.areas.sum()) > 0.6


def test_groups_are_near_face_the_same_way_and_mostly_distinct(cornell):
    scene, points, dense, groups = cornell
    distance = np.linalg.norm(dense.position[groups] - points.position[:, None], axis=-1)
    assert distance.max() < 3.0 * poisson_radius(scene.mesh.areas.sum(), 256)
    assert np.einsum("msd,md->ms", dense.normal[groups], points.normal).min() > 0.5
    assert len(np.unique(groups)) > 0.7 * len(dense)


def test_no_point_on_the_floor_below_the_blocks(cornell):
    _, points, dense, _ = cornell
    turn = rotation_about(1, 17.0)
    for kept in (points, dense):
        floor = kept.position[(kept.position[:, 1] == 0) & (kept.normal[:, 1] > 0)]
        in_block = np.abs((floor - (0.335, 0, 0.38)) @ turn.T)
        assert len(floor) > 20
        assert not np.any((in_block[:, 0] < 0.29) & (in_block[:, 2] < 0.29))


def test_groups_do_not_reach_through_a_wall():
    """A thin wall divides the floor; both halves face up and are near to each other."""
    wall = box((0.004, 0.5, 1.0), 0).transformed(np.eye(3), (0.0, 0.5, 0.0))
    floor = quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], 0)
    scene = Scene("divided", assemble([floor, wall]), (Material(),), Camera((0, 1, 3), (0, 0, 0)))
    points, dense, groups = measurement_points(scene, 200, 8, 0)
    floor_points = np.flatnonzero(points.normal[:, 1] > 0.9)
    floor_points = floor_points[points.position[floor_points, 1] == 0]
    side = np.sign(points.position[floor_points, 0])
    group_side = np.sign(dense.position[groups[floor_points], 0])
    assert np.all(group_side == side[:, None])
    nearest = cKDTree(dense.position).query(points.position[floor_points], 8)[1]
    assert np.any(np.sign(dense.position[nearest, 0]) != side[:, None])  # plain nearest points would have


def test_without_supersampling_each_point_is_its_own_group():
    points, dense, groups = measurement_points(load_scene("two-plates"), 32, 1)
    assert np.array_equal(points.position, dense.position)
    assert groups.tolist() == [[i] for i in range(32)]


@pytest.mark.parametrize("count", [10**6, 10**9])
def test_more_points_than_the_surface_holds(count):
    with pytest.raises(SceneError, match=f"{count} measurement points do not fit on scene 'cornell'.*at most"):
        measurement_points(load_scene("cornell"), count)


@pytest.mark.parametrize(("count", "size"), [(0, 8), (8, 0), (-1, 1)])
def test_counts_must_be_positive(count, size):
    with pytest.raises(SceneError, match="at least 1"):
        measurement_points(load_scene("cornell"), count, size)
