"""Glossy reflection by path tracing against quadrature and closed forms, and against the diffuse reference.

Estimates are compared by their own standard errors, as in `test_reference.py`; the noise itself is bounded too, because
a tracer that seldom meets a light would pass for any value.
"""

import numpy as np
import pytest
from scipy.integrate import dblquad

from data_gen.atlas import surface_points
from data_gen.geometry import assemble, quad
from data_gen.glossy_reference import arriving, reference_radiance
from data_gen.reference import Estimate, direct_irradiance, indirect_irradiance, sample_light
from data_gen.reference_image import camera_directions, reference_image
from data_gen.scenes import load_scene, two_plates
from prt_bench.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
)
from prt_bench.points import SurfacePoints
from prt_bench.scene import Camera, Glossy, Material, Scene

COLOUR = np.array([3.0, 2.0, 1.0])
ALBEDO, SPECULAR = (0.3, 0.2, 0.1), (0.5, 0.4, 0.3)
AT = np.array([0.2, 0.0, -0.1])
EYES = [(0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.1, -1.0)]
LIGHTS = {
    "rect": RectLight([0.3, 1.0, 0.1], [0.5, 0.0, 0.0], [0.1, 0.1, 0.4], COLOUR),
    "sphere": SphereLight([-0.3, 0.8, 0.2], 0.3, COLOUR),
    "environment": EnvironmentLight(np.random.default_rng(0).uniform(0.0, 2.0, (8, 16, 3)), [0.3, 0.2, 0.1]),
}


def agrees(estimate: Estimate, expected: np.ndarray, noise: float) -> None:
    """Within five standard errors of what is expected, and those under a share of it."""
    assert np.all(estimate.standard_error <= noise * np.abs(expected))
    z = (estimate.mean - expected) / np.maximum(estimate.standard_error, 1e-6 * np.abs(expected))
    assert np.abs(z).max() < 5.0


def floor(glossy: Glossy | None, albedo: tuple[float, float, float] = ALBEDO, two_sided: bool = False) -> Scene:
    """A square of side 4 m about the origin, facing up."""
    mesh = assemble([quad([(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], 0)])
    material = Material("floor", albedo, two_sided=two_sided, glossy=glossy)
    return Scene("floor", mesh, (material,), Camera((0, 3, 3), (0, 0, 0)))


def points_at(scene: Scene, face: int, count: int, place: tuple[float, float, float] | None = None) -> SurfacePoints:
    """Copies of one point of a face, given by barycentric coordinates."""
    return surface_points(scene, np.full(count, face), np.tile(place or (0.5, 0.3, 0.2), (count, 1)))


def some_points(scene: Scene, count: int, seed: int) -> SurfacePoints:
    rng = np.random.default_rng(seed)
    face = rng.choice(len(scene.mesh.faces), count, p=scene.mesh.areas / scene.mesh.areas.sum())
    return surface_points(scene, face, rng.dirichlet([1.0, 1.0, 1.0], count))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def reflectance(
    direction: np.ndarray,
    normal: np.ndarray,
    eye: np.ndarray,
    exponent: float,
    albedo: object = ALBEDO,
    k: object = SPECULAR,
) -> np.ndarray:
    """ρ/π + k (s + 1)/(2π) max(ω·ω_r, 0)^s times n·ω, written once more and for one direction."""
    aligned = float(direction @ (2.0 * (normal @ eye) * normal - eye))
    lobe = (exponent + 1.0) / (2.0 * np.pi) * aligned**exponent if aligned > 0 else 0.0
    return (np.asarray(albedo) / np.pi + np.asarray(k) * lobe) * max(float(normal @ direction), 0.0)


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("exponent", [0.0, 1.0, 20.0, 1e6])
def test_directional_light_is_exact(exponent: float, eye: tuple[float, float, float]) -> None:
    scene, up = floor(Glossy(SPECULAR, exponent)), np.array([0.0, 1.0, 0.0])
    for towards in (unit(np.array([-0.5, 1.0, 0.2])), unit(np.array(eye) * (-1, 1, -1))):  # the latter is the mirror's
        lighting = Lighting([DirectionalLight(-towards, COLOUR)])
        found = reference_radiance(scene, lighting, points_at(scene, 0, 1), unit(np.array([eye])), 2)
        towards = -np.asarray(DirectionalLight(-towards, COLOUR).direction, float)  # kept in float32
        expected = COLOUR * reflectance(unit(towards), up, unit(np.array(eye)), exponent)
        np.testing.assert_allclose(found.mean[0], expected, rtol=1e-6 * max(exponent, 1.0) ** 0.5)
        np.testing.assert_array_equal(*found.halves)


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("exponent", [0.0, 5.0, 300.0, 1e5])
def test_white_furnace(exponent: float, eye: tuple[float, float, float]) -> None:
    """Under uniform radiance L an open plane reflects L (ρ + k ∫ n·ω lobe dω); the integral is at most 1."""
    scene = floor(Glossy(SPECULAR, exponent))
    mirror = unit(np.array(eye)) * (-1, 1, -1)
    tilt = np.arccos(mirror[1])

    def integrand(turn: float, t: float) -> float:  # over the lobe: cos α = t^(1/(s + 1)) takes its density up
        cosine = t ** (1.0 / (exponent + 1.0))
        return max(cosine * np.cos(tilt) + np.sqrt(1.0 - cosine**2) * np.sin(tilt) * np.cos(turn), 0.0) / np.pi

    share, _ = dblquad(integrand, 0.0, 1.0, 0.0, np.pi, epsabs=1e-7)
    if eye == EYES[0]:
        assert share == pytest.approx((exponent + 1.0) / (exponent + 2.0), rel=1e-5)
    lighting = Lighting([EnvironmentLight(np.full((8, 16, 3), COLOUR))])
    found = reference_radiance(scene, lighting, points_at(scene, 0, 1), unit(np.array([eye])), 1 << 14)
    agrees(found, (COLOUR * (np.array(ALBEDO) + share * np.array(SPECULAR)))[None], 0.02)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("exponent", [0.0, 3.0, 500.0])
def test_extended_lights_equal_their_integral(name: str, exponent: float) -> None:
    """∫ L f (n·ω) dω over all directions by the midpoint rule, with the light met by each of them or not."""
    scene, light = floor(Glossy(SPECULAR, exponent)), LIGHTS[name]
    points = points_at(scene, 0, 1)
    towards = light.center if isinstance(light, RectLight | SphereLight) else np.array([0.5, 1.0, 0.3])
    eye = unit((np.asarray(towards, float) - points.position[0]) * (-1, 1, -1))
    eye = unit(eye + np.array([0.1, 0.0, 0.05]))
    rows = 1000
    y = (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows)
    ring = np.sqrt(1.0 - y**2)[:, None]
    direction = np.stack([ring * np.sin(turn), np.tile(y[:, None], 2 * rows), ring * np.cos(turn)], -1).reshape(-1, 3)
    lobe = np.maximum(direction @ (eye * (-1, 1, -1)), 0.0) ** exponent * (exponent + 1.0) / (2.0 * np.pi)
    if exponent == 0:
        lobe = np.where(direction @ (eye * (-1, 1, -1)) > 0, lobe, 0.0)
    reflected = (np.array(ALBEDO) / np.pi + lobe[:, None] * SPECULAR) * direction[:, 1:2]
    origin = np.broadcast_to(points.position[0], direction.shape)
    expected = np.sum(arriving(light, origin, direction).radiance * reflected, axis=0) * np.pi / rows**2
    found = reference_radiance(scene, Lighting([light]), points, eye[None], 1 << 15)
    assert np.all(found.standard_error < 0.01 * expected)
    z = (found.mean[0] - expected) / np.hypot(found.standard_error, 1e-3 * expected)  # the rule is that coarse
    assert np.abs(z).max() < 5.0


@pytest.mark.parametrize("name", LIGHTS)
def test_density_is_that_of_the_samples(name: str) -> None:
    """Strength is radiance over density for each sample, and the density of the whole sphere is 1."""
    light: Light = LIGHTS[name]
    origin = np.tile(AT, (20_000, 1))
    rng = np.random.default_rng(4)
    sample = sample_light(light, origin, rng)
    met = arriving(light, origin, sample.direction)
    sound = met.density > 0
    assert sound.mean() > 0.999  # rounding may lose a sample on an edge
    np.testing.assert_allclose(
        (met.radiance / np.maximum(met.density, 1e-30)[:, None])[sound], sample.strength[sound], rtol=1e-6
    )
    np.testing.assert_allclose(met.distance[sound], sample.distance[sound], rtol=1e-6)
    directions = rng.normal(size=(400_000, 3))
    density = arriving(
        light, np.tile(AT, (len(directions), 1)), directions / np.linalg.norm(directions, axis=1)[:, None]
    )
    values = 4.0 * np.pi * density.density
    assert abs(values.mean() - 1.0) < 5.0 * values.std() / np.sqrt(len(values))


def test_one_bounce_between_two_glossy_plates() -> None:
    """Light reflected by the wall towards a point of the floor and from there to the eye, by quadrature over the wall."""
    scene = load_scene("two-plates")
    lobes = Glossy((0.4, 0.3, 0.2), 12.0), Glossy((0.3, 0.2, 0.4), 30.0)  # of floor and wall
    materials = tuple(Material(m.name, m.albedo, glossy=lobe) for m, lobe in zip(scene.materials, lobes, strict=True))
    scene = Scene(scene.name, scene.mesh, materials, scene.camera)
    eye, towards = unit(np.array([-0.1, 0.6, 0.7])), np.array([0.0, 0.6, 0.8])
    points = points_at(scene, 0, 1)
    up, forward = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    grey = np.full(3, two_plates.ALBEDO)
    rows = 400
    x, y = np.meshgrid(*[(np.arange(rows) + 0.5) / rows] * 2)
    offset = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3) - points.position[0]
    distance = np.linalg.norm(offset, axis=1)
    direction = offset / distance[:, None]
    expected = np.zeros(3)
    for way, far in zip(direction, distance, strict=True):
        from_wall = COLOUR * reflectance(towards, forward, -way, 30.0, grey, lobes[1].specular)
        here = reflectance(way, up, eye, 12.0, grey, lobes[0].specular)
        expected += from_wall * here * (-way @ forward) / far**2 / rows**2
    lighting = Lighting([DirectionalLight(-towards, COLOUR)])
    found = [reference_radiance(scene, lighting, points, eye[None], 1 << 15, bounces) for bounces in (0, 1)]
    direct = COLOUR * reflectance(towards, up, eye, 12.0, grey, lobes[0].specular)
    np.testing.assert_allclose(found[0].mean[0], direct, rtol=1e-5)
    error = np.hypot(found[1].standard_error, 1e-3 * expected)
    assert np.all(error < 0.02 * expected)
    assert np.abs((found[1].mean[0] - direct - expected) / error).max() < 5.0
    diffuse = reference_radiance(scene, lighting, points, eye[None], 1 << 15, 1, diffuse_between=True).mean[0] - direct
    assert np.all(np.abs(diffuse - expected) > 10.0 * error)  # the wall's lobe would be missed


@pytest.mark.parametrize("bounces", [0, 2, None])
def test_without_lobes_it_is_the_diffuse_reference(bounces: int | None) -> None:
    scene = load_scene("cornell")
    lighting = Lighting([PointLight([0.4, 1.5, 0.2], COLOUR, 0.0), SphereLight([-0.3, 1.7, 0.3], 0.1, 5.0 * COLOUR)])
    points = some_points(scene, 64, 3)
    found = reference_radiance(scene, lighting, points, points.normal, 2048, bounces)
    direct = direct_irradiance(scene, points.position, points.normal, lighting, 2048, seed=7)
    parts = [direct]
    if bounces != 0:
        parts.append(indirect_irradiance(scene, points.position, points.normal, lighting, 2048, bounces, seed=8))
    factor = points.albedo / np.pi
    expected = factor * sum(part.mean for part in parts)
    error = np.sqrt(found.standard_error**2 + sum((factor * part.standard_error) ** 2 for part in parts))
    z = ((found.mean - expected) / np.maximum(error, 1e-9))[error > 1e-9]
    assert np.abs(z).max() < 5.0
    assert np.sqrt(np.mean(z**2)) < 1.3


def test_seed_and_workers_and_noise_of_the_halves() -> None:
    scene = load_scene("objects")
    lighting = Lighting([SphereLight([0.5, 1.8, 0.8], 0.2, COLOUR)])
    points = some_points(scene, 200, 4)

    def estimate(seed: int, workers: int) -> Estimate:
        return reference_radiance(scene, lighting, points, points.normal, 700, 2, seed, workers)

    first, again = estimate(0, 1), estimate(0, 2)
    np.testing.assert_array_equal(first.halves, again.halves)
    assert not np.array_equal(first.halves, estimate(1, 1).halves)
    # Halves differ by twice the error of their mean, on average over points.
    lit = first.standard_error > 0
    ratio = (first.halves[0] - first.halves[1])[lit] / (2.0 * first.standard_error[lit])
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.25)


def test_directions_behind_and_backs_are_black() -> None:
    lighting = Lighting([PointLight([0.0, -1.5, 0.0], COLOUR, 0.0), PointLight([0.0, 1.5, 0.0], COLOUR, 0.0)])
    scene = floor(Glossy(SPECULAR, 5.0))
    points = points_at(scene, 0, 2)
    eyes = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    found = reference_radiance(scene, lighting, points, eyes, 2).mean
    assert np.all(found[0] > 0)
    assert not found[1].any()
    below = Camera((0.0, -3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert not reference_image(scene, lighting, 6, 8, 2, camera=below).mean.any()
    assert reference_image(floor(Glossy(), two_sided=True), lighting, 6, 8, 2, camera=below).mean[3, 4].all()


def test_picture_is_the_radiance_of_its_pixels() -> None:
    """The middle of a floor under one direction, the sky around it, and noise as stated."""
    scene = floor(Glossy(SPECULAR, 30.0))
    camera = Camera((0.0, 2.0, 2.0), (0.0, 0.0, 0.0), fov_y=120.0)
    lighting = Lighting([DirectionalLight([0.0, -1.0, -1.0], COLOUR)])
    image = reference_image(scene, lighting, 21, 31, 2, camera=camera)
    direction = camera_directions(camera, 21, 31)
    np.testing.assert_allclose(direction[10, 15], unit(np.array([0.0, -1.0, -1.0])), atol=1e-12)
    assert direction[0, 15, 1] > direction[20, 15, 1]
    assert direction[10, 30, 0] > 0
    expected = COLOUR * reflectance(
        unit(np.array([0.0, 1.0, 1.0])), np.array([0.0, 1.0, 0.0]), -direction[10, 15], 30.0
    )
    np.testing.assert_allclose(image.mean[10, 15], expected, rtol=1e-5)
    assert image.hit[10, 15]
    assert not image.hit[0, 0]
    assert image.noise == 0.0
    sky = Lighting([EnvironmentLight(np.full((8, 16, 3), COLOUR)), LIGHTS["rect"]])
    noises = [reference_image(scene, sky, 21, 31, count, bounces=0, camera=camera) for count in (32, 512)]
    np.testing.assert_allclose(noises[0].mean[0, 0], COLOUR)
    assert noises[0].noise == pytest.approx(4.0 * noises[1].noise, rel=0.25)  # as one over the root of the samples
    difference = np.linalg.norm((noises[0].mean - noises[1].mean)[noises[1].hit])
    assert difference / np.linalg.norm(noises[1].mean[noises[1].hit]) == pytest.approx(noises[0].noise, rel=0.25)


def test_lobes_alone_are_what_they_add_to_a_picture() -> None:
    """To a picture of the same surface without them; a diffuse surface has none."""
    camera = Camera((0.1, 1.0, 1.0), (0.0, 0.0, 0.0))
    lighting = Lighting([DirectionalLight([0.1, -1.0, 0.9], COLOUR)])
    shiny, dull = (floor(lobe) for lobe in (Glossy(SPECULAR, 9.0), None))
    whole, rest = (reference_image(scene, lighting, 12, 16, 2, camera=camera).mean for scene in (shiny, dull))
    lobes, none = (
        reference_image(scene, lighting, 12, 16, 2, camera=camera, lobes_alone=True).mean for scene in (shiny, dull)
    )
    np.testing.assert_allclose(lobes, whole - rest, atol=1e-12)
    assert lobes.max() > 0.1
    assert not none.any()
