"""Samples without a mesh, on the unit ball of the furnace, where spacing, curvature, depth and light have closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from data_gen.geometry import assemble, quad
from data_gen.meshless import hemispheres, hidden_by_walls, nearest_hits, walls_around
from data_gen.particles import curvature, particle_samples, thinned
from data_gen.sampling import random_points
from data_gen.scenes import furnace, load_scene
from data_gen.tracer import Tracer
from prt_bench.depth import hemisphere_directions
from prt_bench.errors import SceneError
from prt_bench.hemisphere import tangent_frames
from prt_bench.points import SurfacePoints
from prt_bench.scene import Camera, Material, Scene
from prt_bench.transport import GatherOperator, indirect

SCENE = load_scene("furnace")
TRACER = Tracer(SCENE)
RADIUS = 0.2
POINTS = particle_samples(SCENE, TRACER, (0.3, 0.2, -0.1), RADIUS)


def test_samples_are_apart_by_the_radius_and_leave_no_gap():
    spacing = KDTree(POINTS.position).query(POINTS.position, k=2)[0][:, 1]
    assert spacing.min() >= RADIUS / 3.0  # at most
    assert np.quantile(spacing, 0.05) > RADIUS / (1.0 + 2.0 * RADIUS)  # curvature 1, but by triangles
    gaps = KDTree(POINTS.position).query(random_points(SCENE, 2000).position)[0]
    assert gaps.max() < 1.1 * RADIUS
    jammed = 0.547 * 4.0 * np.pi / (0.25 * np.pi * RADIUS**2)
    assert 1.05 * jammed < len(POINTS) < (1.0 + 1.4 * RADIUS) ** 2 * jammed


def test_flat_surfaces_are_thinned_by_the_radius_itself():
    points = random_points(load_scene("cornell"), 3000)
    kept = points[thinned(points, np.full(3000, 0.2))]
    apart = np.linalg.norm(kept.position[:, None] - kept.position, axis=-1)
    same = kept.normal @ kept.normal.T > 0.5
    assert apart[same & ~np.eye(len(kept), dtype=bool)].min() > 0.2


def test_curvature_is_that_of_a_ball_and_none_at_the_edges_of_a_box():
    assert np.median(curvature(random_points(SCENE, 4000))) == pytest.approx(1.0, rel=0.15)
    box = load_scene("cornell")
    assert not curvature(random_points(box, 2000))[random_points(box, 2000).face < 10].any()


def test_samples_are_deterministic_and_depend_on_the_seed():
    again, other = (particle_samples(SCENE, TRACER, (0.3, 0.2, -0.1), RADIUS, seed) for seed in (0, 1))
    np.testing.assert_array_equal(again.position, POINTS.position)
    assert other.position.shape != POINTS.position.shape or np.any(other.position != POINTS.position)


def test_a_wall_thinner_than_the_radius_keeps_both_sides():
    position = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.01], [0.05, 0.0, 0.0]])
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    points = SurfacePoints(position, normal, 0 * normal, np.zeros(3, int), 0 * normal)
    assert thinned(points, np.full(3, 0.1)).tolist() == [0, 1]


def test_no_sample_where_no_particle_comes():
    with pytest.raises(SceneError, match="start elsewhere"):
        particle_samples(SCENE, TRACER, (5.0, 0.0, 0.0), RADIUS)


def test_light_bounces_between_samples_as_in_the_closed_form():
    hits = nearest_hits(TRACER, POINTS, SCENE.mesh.normals, 16)
    assert hits.max() < len(POINTS)
    gather, albedo = GatherOperator.from_hits(hits, len(POINTS)), jnp.asarray(POINTS.albedo[:, :1])
    found = indirect(gather, albedo, jnp.full((1, len(POINTS), 1), 3.0), 40)
    np.testing.assert_allclose(found, furnace.indirect_irradiance(3.0), rtol=1e-5)


def test_rays_name_the_sample_where_they_land():
    """From inside a ball every direction about the normal ends at the chord's other end."""
    hits = nearest_hits(TRACER, POINTS, SCENE.mesh.normals, 64)
    away = POINTS.position[hits] - POINTS.position[:, None]
    length = np.linalg.norm(away, axis=-1)
    far = length > 3 * RADIUS
    cosine = np.einsum("prd,pd->pr", away, POINTS.normal) / np.where(far, length, 1.0)
    np.testing.assert_allclose(length[far], 2.0 * cosine[far], atol=0.12)
    share = np.mean(length**2)  # cosine-weighted: the mean squared chord is 2
    assert share == pytest.approx(2.0, rel=0.05)


def test_depth_in_a_ball_is_the_chord():
    directions = hemisphere_directions(64)
    depth = hemispheres(TRACER, POINTS, directions)
    high = directions[:, 2] > 0.2
    np.testing.assert_allclose(
        depth[:, high], np.broadcast_to(2.0 * directions[high, 2], depth[:, high].shape), atol=0.1
    )


def test_a_wall_hides_floors_from_each_other_unless_looked_over():
    parts = [
        quad([(0, 0, 0), (0, 0, 2), (2, 0, 2), (2, 0, 0)], 0),
        quad([(1, 0, 0), (1, 0, 2), (1, 0.5, 2), (1, 0.5, 0)], 0),
    ]
    scene = Scene("wall", assemble(parts), (Material("grey", (0.5,) * 3),), Camera((1, 3, 5), (1, 0, 1)))
    points = random_points(scene, 200)
    points = points[points.position[:, 1] == 0]
    left = points.position[:, 0] < 1
    np.testing.assert_array_equal(hidden_by_walls(Tracer(scene), points, 0.1)(3), left != left[3])
    assert not hidden_by_walls(Tracer(scene), points, 0.6)(3).any()


def test_lines_of_walls_part_a_floor_where_they_stand():
    """A floor with an upright wall along x + 0.5 z = 1.2 and one that leans back from z = 2."""
    parts = [
        quad([(0, 0, 0), (0, 0, 3), (3, 0, 3), (3, 0, 0)], 0),
        quad([(1.2, 0, 0), (-0.3, 0, 3), (-0.3, 2, 3), (1.2, 2, 0)], 0),
        quad([(0, 0, 2), (0, 2, 3), (3, 2, 3), (3, 0, 2)], 0),
    ]
    scene = Scene("walls", assemble(parts), (Material("grey", (0.5,) * 3),), Camera((1, 3, 5), (1, 0, 1)))
    points = random_points(scene, 2500)
    upright = points.position[:, 0] + 0.5 * points.position[:, 2]
    points = points[(points.position[:, 1] == 0) & (upright < 1.15) & (points.position[:, 2] < 1.95)]
    walls = walls_around(Tracer(scene), points, scene.mesh.normals)
    frame = tangent_frames(points.normal, np.zeros(len(points)))
    rng = np.random.default_rng(0)
    offset = rng.uniform(-0.8, 0.8, (len(points), 2))
    there = points.position + np.einsum("pa,pax->px", offset, frame[:, :2])
    past = np.stack([there[:, 0] + 0.5 * there[:, 2] - 1.2, there[:, 2] - 2.0], axis=1)
    clear = np.abs(past).min(axis=1) > 1e-2
    behind = (np.einsum("pa,pka->pk", offset, walls) > 1).any(axis=1)
    assert not behind[clear & (past < 0).all(axis=1)].any()
    assert behind[clear & (past[:, 0] > 0)].all()
    assert np.count_nonzero(clear & (past[:, 0] > 0)) > 30
    assert not walls_around(TRACER, POINTS[:0], SCENE.mesh.normals).size
