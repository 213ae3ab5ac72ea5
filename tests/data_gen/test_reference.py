"""The independent path tracer against closed forms, so that it can itself judge the operator.

Estimates are compared by their own standard errors: |z| < 5 for every value (chance 6e-7 each), and where there are
many values a root mean square of z below 1.3, which a bias of one standard error would break.
"""

import numpy as np
import pytest

from data_gen.geometry import assemble, quad
from data_gen.reference import Estimate, direct_irradiance, indirect_irradiance
from data_gen.scenes import furnace, load_scene, two_plates
from prt_bench.lights import (
    DirectionalLight,
    EnvironmentLight,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
    SpotLight,
    emitters,
    irradiance,
)
from prt_bench.scene import Camera, Material, Scene

COLOUR = np.array([3.0, 2.0, 1.0])
UP = np.array([[0.0, 1.0, 0.0]])


def agrees(estimate: Estimate, expected: np.ndarray) -> None:
    z = (estimate.mean - expected) / estimate.standard_error
    assert np.abs(z).max() < 5.0
    assert len(z) < 32 or np.sqrt(np.mean(z**2)) < 1.3


def floor(two_sided: bool = False) -> Scene:
    """A square of side 4 m about the origin, facing up."""
    mesh = assemble([quad([(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], 0)])
    return Scene("floor", mesh, (Material("grey", two_sided=two_sided),), Camera((0, 3, 3), (0, 0, 0)))


def some_points(scene: Scene, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over a scene's area, and their normals."""
    rng = np.random.default_rng(seed)
    face = rng.choice(len(scene.mesh.faces), count, p=scene.mesh.areas / scene.mesh.areas.sum())
    position = np.einsum("pc,pcd->pd", rng.dirichlet([1.0, 1.0, 1.0], count), scene.mesh.triangles[face])
    return position, scene.mesh.normals[face]


def test_punctual_lights_are_exact() -> None:
    lights = (
        PointLight([0.3, 1.2, -0.2], COLOUR, 0.1),
        SpotLight([0.0, 1.5, 0.0], [0.2, -1.0, 0.1], COLOUR, 0.7, 0.4),
        DirectionalLight([0.3, -1.0, 0.2], COLOUR),
    )
    position, normal = some_points(floor(), 64, 0)
    for light in lights:
        lighting = Lighting([light])
        batch = emitters([lighting])
        single = type(batch)(batch.position[0], batch.axis[0], batch.intensity[0], batch.profile[0])
        expected = np.asarray(irradiance(single, position, normal))
        found = direct_irradiance(floor(), position, normal, lighting).mean
        np.testing.assert_allclose(found, expected, rtol=3e-4, atol=1e-4)  # the ray offset moves the point by 1e-4


def test_shadows_fall_behind_occluders_and_no_further() -> None:
    lid = quad([(-0.2, 0.5, -0.2), (0.2, 0.5, -0.2), (0.2, 0.5, 0.2), (-0.2, 0.5, 0.2)], 0)
    ground = quad([(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], 0)
    scene = Scene("lid", assemble([ground, lid]), (Material("grey"),), Camera((0, 3, 3), (0, 0, 0)))
    position = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    above, below, sun = (
        PointLight([0.0, 1.5, 0.0], COLOUR),
        PointLight([0.0, 0.4, 0.0], COLOUR),
        DirectionalLight([0.0, -1.0, 0.0], COLOUR),
    )
    for light, lit in ((above, [False, True]), (below, [True, True]), (sun, [False, True])):
        found = direct_irradiance(scene, position, np.repeat(UP, 2, 0), Lighting([light])).mean
        assert found.any(axis=1).tolist() == lit


def test_sphere_light_has_the_irradiance_of_its_cone() -> None:
    # A sphere wholly above the horizon: E = π L cosθ sin²α, sin α = r / d.
    center, radius = np.array([0.4, 1.5, 0.2]), 0.5
    position = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, -0.3]])
    offset = center - position
    distance = np.linalg.norm(offset, axis=1)
    expected = np.pi * (offset[:, 1] / distance * (radius / distance) ** 2)[:, None] * COLOUR
    lighting = Lighting([SphereLight(center, radius, COLOUR)])
    agrees(direct_irradiance(floor(), position, np.repeat(UP, 2, 0), lighting, 1 << 17), expected)


def test_rectangle_light_has_the_irradiance_of_a_polygon() -> None:
    # Lambert: E = L/2 Σ angle(a, b) (a × b)·n / |a × b| over the edges seen from the point.
    center, u, v = np.array([0.2, 1.0, 0.1]), np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.1, 0.4])
    corners = center + np.array([u * s + v * t for s, t in [(-1, -1), (1, -1), (1, 1), (-1, 1)]])
    expected = 0.0
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        cross = np.cross(a, b)
        angle = np.arctan2(np.linalg.norm(cross), a @ b)
        expected += 0.5 * angle * cross[1] / np.linalg.norm(cross)
    lighting = Lighting([RectLight(center, u, v, COLOUR)])  # u × v points down
    agrees(direct_irradiance(floor(), np.zeros((1, 3)), UP, lighting, 1 << 17), abs(expected) * COLOUR[None])
    behind = Lighting([RectLight(center, v, u, COLOUR)])
    assert not direct_irradiance(floor(), np.zeros((1, 3)), UP, behind, 64).mean.any()


def test_environment_light() -> None:
    # Uniform radiance L over the upper half: E = πL. One texel about +x, turned to +y: E = L · solid angle · cosine.
    upper = np.zeros((16, 32, 3))
    upper[:8] = COLOUR
    agrees(
        direct_irradiance(floor(), np.zeros((1, 3)), UP, Lighting([EnvironmentLight(upper)]), 1 << 17),
        np.pi * COLOUR[None],
    )
    spot = np.zeros((64, 128, 3))
    spot[32, 96] = COLOUR
    turned = EnvironmentLight(spot, [0.0, 0.0, np.pi / 2])
    found = direct_irradiance(floor(), np.zeros((1, 3)), UP, Lighting([turned]), 1 << 12).mean
    solid_angle = np.sin(np.pi / 64) * 2 * np.pi / 128
    np.testing.assert_allclose(found[0], COLOUR * solid_angle, rtol=2e-3)


def test_furnace_matches_the_geometric_series() -> None:
    scene = load_scene("furnace")
    lighting = Lighting([PointLight([0.2, -0.3, 0.1], COLOUR, 0.0)])
    everywhere, facing = some_points(scene, 1 << 15, 1)
    mean_direct = direct_irradiance(scene, everywhere, facing, lighting).mean.mean(axis=0)
    expected = furnace.indirect_irradiance(1.0) * mean_direct
    estimate = indirect_irradiance(scene, everywhere[:16], facing[:16], lighting, 1 << 14)
    # The closed form is a sphere's; 5,120 flat faces are within 0.2 % of it.
    z = (estimate.mean - expected) / np.hypot(estimate.standard_error, 2e-3 * expected)
    assert np.abs(z).max() < 5.0


@pytest.mark.parametrize(("plate", "direct"), [(two_plates.FLOOR, 0.8), (two_plates.WALL, 0.6)])
def test_two_plates_match_the_view_factor(plate: int, direct: float) -> None:
    scene = load_scene("two-plates")
    lighting = Lighting([DirectionalLight([0.0, -0.6, -0.8], COLOUR)])  # 0.6 on the floor, 0.8 on the wall
    spread = np.random.default_rng(2).uniform(0.02, 0.98, (32, 2))
    across = 2 if plate == two_plates.FLOOR else 1
    position = np.zeros((32, 3))
    position[:, 0], position[:, across] = spread.T
    normal = np.zeros((32, 3))
    normal[:, 3 - across] = 1.0
    estimate = indirect_irradiance(scene, position, normal, lighting, 1 << 14, bounces=1)
    agrees(estimate, two_plates.ALBEDO * direct * two_plates.view_factor(position)[:, None] * COLOUR)


def test_bounces_add_up_and_roulette_is_unbiased() -> None:
    scene = load_scene("furnace")
    lighting = Lighting([PointLight([0.0, 0.0, 0.0], COLOUR, 0.0)])
    position, normal = some_points(scene, 8, 3)
    one = indirect_irradiance(scene, position, normal, lighting, 1 << 12, bounces=1).mean
    two = indirect_irradiance(scene, position, normal, lighting, 1 << 12, bounces=2).mean
    everything = indirect_irradiance(scene, position, normal, lighting, 1 << 12)
    # A light at the centre gives every point the same direct light, so each path's value is almost constant.
    np.testing.assert_allclose(two, one * (1.0 + furnace.ALBEDO), rtol=1e-3)
    z = (everything.mean - one / (1.0 - furnace.ALBEDO)) / np.hypot(everything.standard_error, 2e-3 * one)
    assert np.abs(z).max() < 5.0


def test_one_sided_surfaces_are_black_from_behind() -> None:
    # A lamp below the floor lights its underside; a ceiling point above a one-sided ceiling sees no light from it.
    lighting = Lighting([PointLight([0.0, -1.5, 0.0], COLOUR, 0.0)])
    below, down = np.array([[0.3, -1.0, 0.2]]), UP
    assert not indirect_irradiance(floor(), below, down, lighting, 256).mean.any()
    assert np.all(indirect_irradiance(floor(two_sided=True), below, down, lighting, 256).mean > 0)


def test_result_depends_on_the_seed_but_not_on_the_workers() -> None:
    scene = load_scene("two-plates")
    lighting = Lighting([SphereLight([0.5, 0.8, 0.8], 0.1, COLOUR)])
    position, normal = some_points(scene, 100, 4)

    def halves(seed: int, workers: int) -> np.ndarray:
        return indirect_irradiance(scene, position, normal, lighting, 1400, seed=seed, workers=workers).halves

    np.testing.assert_array_equal(halves(0, 1), halves(0, 2))
    assert not np.array_equal(halves(0, 1), halves(1, 1))
    assert not np.array_equal(*halves(0, 1))
