"""The operator and the reference path tracer against mitsuba, with mitsuba's own noise accounted for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_gen.atlas import surface_points
from data_gen.glossy_reference import reference_radiance
from data_gen.plan import plan
from data_gen.reference import indirect_irradiance
from data_gen.scenes import load_scene
from data_gen.trace import trace
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.lights import DirectionalLight, Lighting, PointLight
from prt_bench.scene import Glossy
from tests.oracles.mitsuba_oracle import MitsubaOracle, unavailable
from tests.oracles.operator_light import operator_light, squared_error

pytestmark = pytest.mark.oracle

COLOUR = (3.0, 2.0, 1.0)
LIGHTINGS = [
    Lighting([PointLight(place, COLOUR, 0.0)]) for place in ([0.4, 1.5, 0.2], [0.7, 0.9, -0.3], [0.1, 1.6, 0.5])
]
TEXELS = 800
PATHS = 1024


@pytest.fixture(scope="module")
def oracle() -> MitsubaOracle:
    if reason := unavailable():
        pytest.skip(reason)
    return MitsubaOracle(load_scene("cornell"))


@pytest.fixture(scope="module")
def transport(tmp_path_factory: pytest.TempPathFactory) -> Transport:
    scene = load_scene("cornell")
    folder: Path = tmp_path_factory.mktemp("transport")
    return trace(scene, plan(scene, texels=128, rays=1024), 0, folder, Tracer(scene))


def test_operator_is_within_one_percent_of_mitsuba(transport: Transport, oracle: MitsubaOracle) -> None:
    chosen = np.random.default_rng(0).choice(len(transport.receivers), TEXELS, replace=False)
    points = transport.receivers[chosen]
    _, found = operator_light(transport, LIGHTINGS)
    errors, brighter = [], []
    for row, lighting in enumerate(LIGHTINGS):
        halves = [
            oracle.indirect_irradiance(points.position, points.normal, lighting, PATHS, seed=seed) for seed in (1, 2)
        ]
        errors.append(squared_error(found[row, chosen], *halves))
        brighter.append(squared_error(1.03 * found[row, chosen], *halves)[0])
    squared, uncertainty = (
        np.mean([error for error, _ in errors]),
        np.hypot.reduce([u for _, u in errors]) / len(errors),
    )
    assert squared < 0.01**2 + 2.0 * uncertainty
    assert np.mean(brighter) > 0.01**2 + 2.0 * uncertainty  # 3 % more light would be noticed


@pytest.mark.parametrize("bounces", [1, 2, None])
def test_reference_agrees_with_mitsuba(bounces: int | None, oracle: MitsubaOracle) -> None:
    scene = load_scene("cornell")
    rng = np.random.default_rng(3)
    face = rng.choice(len(scene.mesh.faces), 128, p=scene.mesh.areas / scene.mesh.areas.sum())
    position = np.einsum("pc,pcd->pd", rng.dirichlet([1.0, 1.0, 1.0], 128), scene.mesh.triangles[face])
    normal = scene.mesh.normals[face]
    lighting = Lighting([PointLight([0.4, 1.5, 0.2], COLOUR, 0.0), DirectionalLight([0.2, -0.5, -1.0], COLOUR)])
    ours = indirect_irradiance(scene, position, normal, lighting, 4096, bounces)
    theirs = oracle.indirect_irradiance(position, normal, lighting, 4096, bounces, seed=5)
    lit = ours.standard_error.min(axis=1) > 0
    assert not theirs[~lit].any()
    # Equal numbers of equally distributed paths: the difference has √2 of the standard error.
    z = (ours.mean - theirs)[lit] / (np.sqrt(2.0) * ours.standard_error[lit])
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert abs(z.mean()) < 5.0 / np.sqrt(len(z))


@pytest.mark.parametrize("bounces", [0, 2])
def test_glossy_reference_agrees_with_mitsuba(bounces: int, oracle: MitsubaOracle) -> None:
    cornell = load_scene("cornell")
    lobes = Glossy((0.25, 0.2, 0.15), 15.0), Glossy((0.3, 0.3, 0.3), 60.0), Glossy((0.5, 0.4, 0.3), 0.0)
    scene = replace(
        cornell, materials=tuple(replace(m, glossy=g) for m, g in zip(cornell.materials, lobes, strict=True))
    )
    rng = np.random.default_rng(4)
    face = rng.choice(len(scene.mesh.faces), 128, p=scene.mesh.areas / scene.mesh.areas.sum())
    points = surface_points(scene, face, rng.dirichlet([1.0, 1.0, 1.0], 128))
    eye = rng.normal(size=(128, 3))
    eye = points.normal + 0.95 * eye / np.linalg.norm(eye, axis=1, keepdims=True)
    eye /= np.linalg.norm(eye, axis=1, keepdims=True)
    lights = PointLight([0.4, 1.5, 0.2], COLOUR, 0.0), DirectionalLight([0.2, -0.5, -1.0], COLOUR)
    ours = reference_radiance(scene, Lighting(lights), points, eye, 4096, bounces)
    glossy = MitsubaOracle(scene)  # it would choose between lights at random: one at a time
    theirs = sum(glossy.radiance(points.position, eye, Lighting([each]), 4096, bounces, seed=5) for each in lights)
    # Direct light is exact in either, but for mitsuba's float32. Of the rest both are noisy, and mitsuba, which samples
    # the lobe by halves, a little more.
    error = np.hypot(np.sqrt(2.5) * ours.standard_error, 2e-3 * ours.mean) + 1e-6
    z = (ours.mean - theirs) / error
    near_edge = np.abs(z).max(axis=1) > 6.0  # a shadow ray that one of the two lets pass
    assert near_edge.sum() <= 2
    z = z[~near_edge]
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert abs(z.mean()) < 0.1
