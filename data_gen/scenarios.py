"""Scenarios: seeded, well-spread distributions of lightings that make sense for a scene's geometry.

A scenario names one kind of light. Its lightings are points of a scrambled Sobol sequence (Owen 1998), of which those
are kept that stand in free space and reach the front of some surface. Each light's flux is `level` times the scene's
area, so that the mean direct irradiance is about `level` W/m², between 0.5 and 2.
"""

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import lru_cache
from math import ceil

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from data_gen.assets import environment_maps
from data_gen.sampling import random_points
from data_gen.tracer import Tracer
from prt_bench.environment import LUMINANCE, EnvironmentMap, texel_directions
from prt_bench.errors import LightError, SpecError
from prt_bench.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
    SpotLight,
)
from prt_bench.points import SurfacePoints
from prt_bench.scene import Scene

_MARGIN = 0.25  # by which the box that lights stand in exceeds the scene's, relative to its longest side
_CLEARANCE = 0.03  # least distance of a light from any surface, relative to the extent
_OF_THE_BEST = 0.25
_LEVELS = (0.5, 2.0)
_SOURCE_RADIUS = 0.003  # of point and spot lights, relative to the extent
_LIT_SHARE = 0.02  # of the surface that a distant light must reach
_WAVE = 128  # Sobol points drawn at a time
_LEAST_SHARE = 1 / 1024  # of candidates that must stand free, or the search is given up
_TRIED = 8192  # candidates of which at least one must
_DIMENSIONS = 12  # of the Sobol sequence: 0-2 place, 3-5 aim, 6-7 shape, 8 level, 9-11 colour
_PROBES = 256  # surface points that tell what a light reaches
_PLACES = 64  # of them, that tell how much room there is


def sample_lightings(
    scene: Scene,
    scenario: str,
    count: int,
    seed: int | Sequence[int],
    tracer: Tracer,
    achromatic: bool | None = None,
) -> tuple[Lighting, ...]:
    """`count` lightings of one light each. Sets of different seeds, and of different scenarios, are independent.

    Lights are coloured unless `achromatic` (by default: whether the scene is). Raises `SpecError` for an unknown
    scenario and `LightError` where the scene has no room for such lights or none could reach it.
    """
    check_scenario(scenario)
    if count < 1:
        raise LightError(f"{count} lightings of scenario '{scenario}' were asked for, but at least 1 is needed")
    grey = scene.achromatic if achromatic is None else achromatic
    entropy = np.random.SeedSequence([SCENARIOS.index(scenario), *np.atleast_1d(seed).tolist()])
    sobol = qmc.Sobol(_DIMENSIONS, rng=np.random.default_rng(entropy))
    lights: list[Light] = []
    tried, most = 0, ceil(count / _LEAST_SHARE)
    while tried < most and (lights or tried < _TRIED):
        lights += _PROPOSALS[scenario](scene, tracer, sobol.random(_WAVE), grey)
        tried += _WAVE
        if len(lights) >= count:
            return tuple(Lighting((light,)) for light in lights[:count])
    raise LightError(
        f"scene '{scene.name}' has no place for {count} lightings of scenario '{scenario}':"
        f" only {len(lights)} of {tried} candidates stand free and reach a surface's front"
    )


def check_scenario(name: str) -> None:
    """Raise `SpecError`, with the nearest name, for what is no scenario."""
    if name not in _PROPOSALS:
        nearest = get_close_matches(name, SCENARIOS, 1, 0.0)[0]
        raise SpecError(f"unknown scenario '{name}'; did you mean '{nearest}' (of {', '.join(SCENARIOS)})?")


def check_lightings(scene: Scene, lightings: Sequence[Lighting], tracer: Tracer) -> None:
    """Raise `LightError` when there is no lighting, or for the first light that is not physical or inside geometry."""
    if not lightings:
        raise LightError("no lightings were given; at least one is needed, and a Lighting without lights is darkness")
    owners, points = [], []
    for index, lighting in enumerate(lightings):
        lighting.check()
        for light in lighting.lights:
            position = np.asarray(light.emitters().position)
            near = position[position[:, 3] > 0, :3]
            owners += [(index, light)] * len(near)
            points.append(near)
    if not owners:
        return
    places = np.concatenate(points)
    inside = np.flatnonzero(tracer.inside(places))
    if inside.size:
        (index, light), place = owners[inside[0]], places[inside[0]]
        raise LightError(
            f"lighting {index}: a {type(light).__name__} lies inside the geometry of scene '{scene.name}'"
            f" at ({', '.join(f'{value:.3g}' for value in place)}); move it into free space"
        )


def _points(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    place, unit, _ = _free_places(scene, tracer, unit)
    intensity = _flux(scene, unit, grey) / (4.0 * np.pi)
    radius = _SOURCE_RADIUS * scene.extent
    return [PointLight(*values, radius) for values in zip(place, intensity, strict=True)]


def _behind(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    """Point lights beyond what the camera looks at, as the camera sees it."""
    low, high = near_region(scene)
    target = np.asarray(scene.camera.target, float)
    ahead = target - scene.camera.position
    return _points(scene, tracer, unit[(low + unit[:, :3] * (high - low) - target) @ ahead > 0], grey)


def _spots(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    place, unit, _ = _free_places(scene, tracer, unit)
    cutoff = np.radians(20.0 + 30.0 * unit[:, 6])
    falloff = 0.2 + 0.4 * unit[:, 7]
    intensity = _flux(scene, unit, grey) / (2.0 * np.pi * (1.0 - np.cos(cutoff)))[:, None]
    radius = _SOURCE_RADIUS * scene.extent
    aim = _targets(scene, unit) - place
    return [SpotLight(*values, radius) for values in zip(place, aim, intensity, cutoff, falloff, strict=True)]


def _areas(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    """Spheres and rectangles by turns. No light reaches farther than half-way to the nearest surface."""
    place, unit, clearance = _free_places(scene, tracer, unit)
    flux, aim = _flux(scene, unit, grey), _targets(scene, unit) - place
    size = np.minimum((0.02 + 0.05 * unit[:, 6]) * scene.extent, 0.5 * clearance)
    lights: list[Light] = []
    for index, center in enumerate(place):
        if index % 2 == 0:
            radiance = flux[index] / (4.0 * np.pi**2 * size[index] ** 2)
            lights.append(SphereLight(center, size[index], radiance))
        else:
            # Half-edges whose diagonal is `size`, with an aspect ratio between 1 : 3 and 3 : 1.
            angle = np.arctan(3.0 ** (2.0 * unit[index, 7] - 1.0))
            u, v = _tangents(aim[index])
            u, v = u * size[index] * np.cos(angle), v * size[index] * np.sin(angle)
            area = 4.0 * np.linalg.norm(np.cross(u, v))
            lights.append(RectLight(center, u, v, flux[index] / (np.pi * area)))
    return lights


def _directions(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    direction = _on_sphere(unit)
    kept = _lit_share(scene, tracer, direction) >= _LIT_SHARE
    # A convex body shows a quarter of its surface to a direction, on average (Cauchy).
    irradiance = 4.0 * _flux(scene, unit, grey) / scene.mesh.areas.sum()
    return [DirectionalLight(*values) for values in zip(direction[kept], irradiance[kept], strict=True)]


def _environments(scene: Scene, tracer: Tracer, unit: np.ndarray, grey: bool) -> list[Light]:
    """The vendored maps, turned about the vertical by any angle and tilted by up to 30°."""
    if np.max(_lit_share(scene, tracer, _on_sphere(unit))) < _LIT_SHARE:
        return []
    maps = _normalised_maps(grey)
    which = np.minimum((unit[:, 0] * len(maps)).astype(int), len(maps) - 1)
    turn = Rotation.from_rotvec(2.0 * np.pi * unit[:, 1:2] * np.array([0.0, 1.0, 0.0]))
    heading = 2.0 * np.pi * unit[:, 2]
    tilt_axis = np.stack([np.cos(heading), np.zeros_like(heading), np.sin(heading)], axis=1)
    tilt = Rotation.from_rotvec(tilt_axis * np.radians(30.0) * unit[:, 3:4])
    return [EnvironmentLight(maps[i], axis) for i, axis in zip(which, (tilt * turn).as_rotvec(), strict=True)]


_Proposal = Callable[[Scene, Tracer, np.ndarray, bool], list[Light]]
_PROPOSALS: dict[str, _Proposal] = {
    "spot": _spots,
    "point": _points,
    "directional": _directions,
    "area": _areas,
    "environment": _environments,
    "behind": _behind,
}
SCENARIOS = tuple(_PROPOSALS)
"""Names of the scenarios."""


def near_region(scene: Scene) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest corner of the box that places of near lights are drawn from; those inside bodies are left out."""
    margin = _MARGIN * np.ptp(scene.bounds, axis=0).max()
    return scene.bounds + np.array([[-margin], [margin]])


def _free_places(
    scene: Scene, tracer: Tracer, unit: np.ndarray
) -> tuple[Float[np.ndarray, "n 3"], np.ndarray, Float[np.ndarray, " n"]]:
    """Places that stand free and face fronts of surfaces, their rows of `unit`, and their distance to the scene.

    In a building of many rooms no place is far from a wall or sees much of the whole; see `_least`.
    """
    low, high = near_region(scene)
    place = low + unit[:, :3] * (high - low)
    clearance = tracer.clearance(place)
    free = np.isfinite(clearance) & ~tracer.inside(place)
    front, back = _seen_from(scene, tracer, place)
    least = _least(scene, tracer)
    free &= (clearance >= least[0]) & (front >= least[1]) & (back <= 0.25 * front)
    return place[free], unit[free], clearance[free]


def _least(scene: Scene, tracer: Tracer) -> tuple[float, float]:
    """Clearance and share of fronts that a place must have: at most a quarter of what the best of some places has.

    Those lie half-way between a point on the surface and what is opposite to it.
    """
    points = _probes(scene)[:_PLACES]
    ahead = tracer.intersect(points.position + tracer.offset * points.normal, points.normal)
    half = 0.5 * np.minimum(ahead.distance, scene.extent)[:, None]
    middle = points.position + half * points.normal
    clearance, (front, _) = tracer.clearance(middle), _seen_from(scene, tracer, middle)
    best = np.max(clearance, initial=0.0, where=np.isfinite(clearance)), np.max(front)
    return min(_CLEARANCE * scene.extent, _OF_THE_BEST * best[0]), min(_LIT_SHARE, _OF_THE_BEST * best[1])


def _seen_from(
    scene: Scene, tracer: Tracer, place: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Shares of what is seen from places, towards random surface points, that are fronts and backs."""
    targets = _probes(scene).position
    direction = targets[None] - place[:, None]
    origin = np.broadcast_to(place[:, None], direction.shape)
    hits = tracer.intersect(origin.reshape(-1, 3), direction.reshape(-1, 3))
    met = hits.face >= 0
    return tuple((side & met).reshape(direction.shape[:2]).mean(axis=1) for side in (hits.front, ~hits.front))


def _lit_share(scene: Scene, tracer: Tracer, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Share of the surface that light travelling along each direction reaches."""
    points = _probes(scene)
    facing = -direction @ points.normal.T > 0
    origin = points.position + tracer.offset * points.normal
    starts = np.broadcast_to(origin, (len(direction), *origin.shape)).reshape(-1, 3)
    reach = np.repeat(-2.0 * scene.extent * direction, len(origin), axis=0)
    return (facing & ~tracer.occluded(starts, reach).reshape(facing.shape)).mean(axis=1)


def _probes(scene: Scene) -> SurfacePoints:
    return random_points(scene, _PROBES)


def _targets(scene: Scene, unit: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Points on the surface, uniform in area, from Sobol coordinates."""
    cumulative = np.cumsum(scene.mesh.areas)
    face = np.minimum(np.searchsorted(cumulative, unit[:, 3] * cumulative[-1], side="right"), len(cumulative) - 1)
    root, along = np.sqrt(unit[:, 4]), unit[:, 5]
    barycentric = np.stack([1.0 - root, root * (1.0 - along), root * along], axis=1)
    return np.einsum("nc,ncd->nd", barycentric, scene.mesh.triangles[face])


def _on_sphere(unit: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Unit vectors, uniform in solid angle, from the first two Sobol coordinates."""
    y, angle = 1.0 - 2.0 * unit[:, 0], 2.0 * np.pi * unit[:, 1]
    ring = np.sqrt(1.0 - y**2)
    return np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1)


def _flux(scene: Scene, unit: np.ndarray, grey: bool) -> Float[np.ndarray, "n 3"]:
    """Flux in W per channel: the level, log-uniform, times the surface's area, times a colour of mean 1."""
    low, high = np.log(_LEVELS)
    level = np.exp(low + (high - low) * unit[:, 8:9])
    colour = np.ones((len(unit), 3)) if grey else 0.4 + 0.6 * unit[:, 9:12]
    return level * scene.mesh.areas.sum() * colour / colour.mean(axis=1, keepdims=True)


def _tangents(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Unit vectors u, v with u × v along `axis`."""
    normal = axis / np.linalg.norm(axis)
    u = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    u /= np.linalg.norm(u)
    return u, np.cross(normal, u)


@lru_cache(maxsize=2)
def _normalised_maps(grey: bool) -> tuple[EnvironmentMap, ...]:
    """The vendored maps, each scaled to a mean radiance of 1/π, which lights an exposed body with 1 W/m² on average."""
    maps = []
    for name, path in environment_maps().items():
        radiance = EnvironmentMap.read(path).radiance
        if grey:
            radiance = np.repeat((radiance @ LUMINANCE)[..., None], 3, axis=-1)
        _, solid_angle = texel_directions(*radiance.shape[:2])
        mean = float(np.sum(radiance.mean(axis=-1) * solid_angle) / (4.0 * np.pi))
        maps.append(EnvironmentMap(name + "-grey" * grey, (radiance / (np.pi * mean)).astype(np.float32)))
    return tuple(maps)
