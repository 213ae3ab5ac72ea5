"""Scenarios: lightings that stand free, reach the scene, spread out, and can be had again."""

import jax
import numpy as np
import pytest

from data_gen.levels import EDGE, scene_of
from data_gen.sampling import random_points
from data_gen.scenarios import SCENARIOS, check_lightings, sample_lightings
from data_gen.scenes import load_scene
from data_gen.tracer import Tracer
from prt_bench.errors import LightError, SpecError
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
from prt_bench.modular.level import maze

KINDS = {
    "spot": {SpotLight},
    "point": {PointLight},
    "directional": {DirectionalLight},
    "area": {SphereLight, RectLight},
    "environment": {EnvironmentLight},
    "behind": {PointLight},
}


@pytest.fixture(scope="module")
def cornell():
    scene = load_scene("cornell")
    return scene, Tracer(scene)


@pytest.fixture(scope="module")
def suzanne():
    scene = load_scene("suzanne")
    return scene, Tracer(scene)


def places(lightings):
    rows = np.concatenate([np.asarray(lighting.lights[0].emitters().position) for lighting in lightings])
    return rows[rows[:, 3] > 0, :3]


def mean_direct(scene, tracer, lighting, count=400):
    """Mean direct irradiance with shadows, by its own few lines."""
    points = random_points(scene, count, 1)
    one = jax.tree.map(lambda a: a[0], emitters([lighting]))
    position = np.asarray(one.position)
    start = points.position + tracer.offset * points.normal
    segment = np.where(
        position[None, :, 3:] > 0,
        position[None, :, :3] - start[:, None],
        9.0 * position[None, :, :3] + 0 * start[:, None],
    )
    origin = np.broadcast_to(start[:, None], segment.shape)
    seen = ~tracer.occluded(origin.reshape(-1, 3), segment.reshape(-1, 3)).reshape(segment.shape[:2])
    return np.asarray(irradiance(one, points.position, points.normal, seen)).mean(axis=0)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", ["cornell", "suzanne"])
def test_lights_are_of_their_kind_and_light_the_scene(scenario, name, request):
    scene, tracer = request.getfixturevalue(name)
    lightings = sample_lightings(scene, scenario, 24, 0, tracer)
    assert {type(lighting.lights[0]) for lighting in lightings} == KINDS[scenario]
    check_lightings(scene, lightings, tracer)
    direct = np.array([mean_direct(scene, tracer, lighting).mean() for lighting in lightings])
    assert direct.min() > 0
    assert 0.1 < direct.mean() < 3.0


@pytest.mark.parametrize("scenario", ["spot", "point", "area"])
def test_lights_stand_in_the_box_or_shortly_in_front_of_it(cornell, scenario):
    scene, tracer = cornell
    position = places(sample_lightings(scene, scenario, 64, 0, tracer))
    low, high = scene.bounds
    in_box = np.all((position > low) & (position < high), axis=1)
    assert 0.5 < in_box.mean() < 1.0
    assert np.all(position[~in_box, 2] > high[2])  # the others stand before the opening, none behind a wall
    assert position[:, 2].max() < 1.75


def test_lights_behind_are_beyond_what_the_camera_looks_at(suzanne):
    scene, tracer = suzanne
    aim = np.subtract(scene.camera.target, scene.camera.position)
    beyond = (
        (places(sample_lightings(scene, "behind", 64, 0, tracer)) - scene.camera.target) @ aim / np.linalg.norm(aim)
    )
    anywhere = (places(sample_lightings(scene, "point", 64, 0, tracer)) - scene.camera.target) @ aim
    assert beyond.min() > 0
    assert beyond.max() > 0.5  # metres: not all of them close by
    assert (anywhere < 0).mean() > 0.25


@pytest.mark.parametrize("scenario", ["spot", "point"])
def test_lights_keep_clear_of_surfaces(suzanne, scenario):
    scene, tracer = suzanne
    position = places(sample_lightings(scene, scenario, 64, 0, tracer))
    surface = random_points(scene, 20_000, 0).position
    nearest = np.array([np.linalg.norm(surface - p, axis=1).min() for p in position])
    assert nearest.min() > 0.01 * scene.extent
    assert position[:, 1].min() > 0  # above the ground


def test_spots_aim_at_the_scene(cornell):
    scene, tracer = cornell
    spots = [lighting.lights[0] for lighting in sample_lightings(scene, "spot", 64, 0, tracer)]
    origin, direction = (np.array([getattr(s, name) for s in spots]) for name in ("position", "direction"))
    assert np.all(tracer.intersect(origin, direction).face >= 0)
    cutoff = np.degrees([float(s.cutoff) for s in spots])
    assert cutoff.min() >= 20
    assert cutoff.max() <= 50
    assert np.ptp(cutoff) > 25


def test_rectangles_emit_towards_the_scene(cornell):
    scene, tracer = cornell
    rectangles = [lighting.lights[0] for lighting in sample_lightings(scene, "area", 32, 0, tracer)]
    rectangles = [light for light in rectangles if isinstance(light, RectLight)]
    origin = np.array([r.center for r in rectangles])
    normal = np.array([np.cross(r.u, r.v) for r in rectangles])
    assert np.all(tracer.intersect(origin, normal).face >= 0)


def test_positions_spread_better_than_random(cornell):
    """Every octant of the box's interior holds its share, within what a random choice would often miss."""
    scene, tracer = cornell
    position = places(sample_lightings(scene, "point", 128, 0, tracer))
    inside = position[position[:, 2] < 1.0]
    octant = ((inside > (0.0, 1.0, 0.0)) @ np.array([1, 2, 4])).astype(int)
    counts = np.bincount(octant, minlength=8)
    assert counts.min() > 0.3 * counts.mean()


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_seeds_and_scenarios_are_reproducible_and_independent(cornell, scenario):
    scene, tracer = cornell

    def draw(seed):
        return [lighting.lights[0].to_json() for lighting in sample_lightings(scene, scenario, 8, seed, tracer)]

    first = draw(0)
    assert first == draw(0)
    assert not any(light in first for light in draw(1))
    assert draw([0, 1]) != first
    assert sample_lightings(scene, scenario, 4, 0, tracer)[3].lights[0].to_json() == first[3]  # a prefix


def test_greyness_follows_the_scene(cornell):
    scene, tracer = cornell
    coloured = np.array([light.lights[0].intensity for light in sample_lightings(scene, "point", 16, 0, tracer)])
    grey = np.array([light.lights[0].intensity for light in sample_lightings(scene, "point", 16, 0, tracer, True)])
    assert np.ptp(coloured, axis=1).min() > 0
    assert (coloured.max(axis=1) / coloured.min(axis=1)).max() < 2.6
    assert np.all(np.ptp(grey, axis=1) == 0)
    assert grey[:, 0].max() > 2 * grey[:, 0].min()
    furnace = load_scene("furnace")
    light = sample_lightings(furnace, "spot", 1, 0, Tracer(furnace))[0].lights[0]
    assert np.ptp(light.intensity) == 0


def test_grey_environments_are_grey_and_of_one_mean(cornell):
    scene, tracer = cornell
    lights = [lighting.lights[0] for lighting in sample_lightings(scene, "environment", 32, 0, tracer, True)]
    assert len({light.map.name for light in lights}) >= 7
    for light in lights:
        assert np.ptp(light.map.radiance, axis=-1).max() == 0


def test_a_closed_scene_has_no_light_from_outside():
    scene = load_scene("furnace")
    for scenario in ("directional", "environment"):
        with pytest.raises(LightError, match="no place for 4 lightings"):
            sample_lightings(scene, scenario, 4, 0, Tracer(scene))


def test_unknown_scenario_names_the_nearest(cornell):
    with pytest.raises(SpecError, match="did you mean 'spot'"):
        sample_lightings(cornell[0], "spott", 4, 0, cornell[1])


def test_zero_lightings_are_refused(cornell):
    with pytest.raises(LightError, match="at least 1"):
        sample_lightings(cornell[0], "spot", 0, 0, cornell[1])
    with pytest.raises(LightError, match="no lightings"):
        check_lightings(cornell[0], [], cornell[1])


@pytest.mark.parametrize(
    "light",
    [
        PointLight((0.335, 0.3, 0.38), (1, 1, 1)),
        SpotLight((-0.33, 0.6, -0.28), (0, -1, 0), (1, 1, 1)),
        SphereLight((0.335, 0.3, 0.38), 0.05, (1, 1, 1)),
        RectLight((-0.33, 0.6, -0.28), (0.05, 0, 0), (0, 0, 0.05), (1, 1, 1)),
    ],
)
def test_light_inside_a_block_is_refused_with_its_place(cornell, light):
    scene, tracer = cornell
    fine = Lighting([PointLight((0, 1.5, 0), (1, 1, 1))])
    with pytest.raises(LightError, match=rf"lighting 1: a {type(light).__name__} lies inside .*'cornell' at \(-?0\.\d"):
        check_lightings(scene, [fine, Lighting([light])], tracer)


def test_distant_and_dark_lightings_pass(cornell):
    scene, tracer = cornell
    check_lightings(scene, [Lighting([]), Lighting([DirectionalLight((0, -1, 0), (1, 1, 1))])], tracer)
    check_lightings(scene, [Lighting([PointLight((0, 5, 9), (1, 1, 1))])], tracer)


def test_unphysical_light_is_refused(cornell):
    with pytest.raises(LightError, match="negative"):
        check_lightings(cornell[0], [Lighting([PointLight((0, 1.5, 0), (-1, 1, 1))])], cornell[1])


def test_in_a_maze_of_many_rooms_lights_stand_in_the_rooms():
    """No place is far from a wall there, for its size, and none sees much of it."""
    scene = scene_of(maze(60, 1))
    tracer = Tracer(scene)
    lights = sample_lightings(scene, "point", 24, 0, tracer)
    place = np.array([lighting.lights[0].position for lighting in lights])  # pyright: ignore
    cells = {tuple(cell) for cell in np.round(place / EDGE).astype(int).tolist()}
    assert cells <= set(maze(60, 1).cells)
    assert len(cells) > 8
    assert np.all(np.abs(place[:, 1]) < 0.5 * EDGE)
    assert tracer.clearance(place).min() > 0.1 * EDGE
