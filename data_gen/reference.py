"""An independent path tracer: what the operator of `prt_bench.transport` must agree with.

It follows every path bounce by bounce, with next-event estimation from the lights' own parameters (area lights over
their whole surface, environment maps texel by texel) and the exact albedo of every hit. Of the bake it shares the ray
queries alone. Slow by design; for checks, not for data. Glossy reflection is followed in `glossy_reference.py`, and the way
through translucent bodies in `medium_reference.py`.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, singledispatch
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from data_gen.medium_reference import Media
from data_gen.tracer import Tracer
from prt_bench.environment import EnvironmentMap
from prt_bench.errors import SceneError
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
from prt_bench.scene import Scene

PATHS_AT_ONCE = 1 << 16
"""Paths followed together by one worker."""
ROULETTE_FROM = 3
"""Bounces before Russian roulette may end a path."""
OFFSET = 1e-5
"""Ray offset relative to the scene's size, along the normal."""


@dataclass(frozen=True)
class Estimate:
    """A Monte Carlo estimate at P points: of irradiance in W/m², or of radiance in W/m²/sr (`glossy_reference.py`).

    `halves` [2, P, 3] are means over disjoint halves of the samples, so their errors are independent;
    `standard_error` [P, 3] is that of `mean`.
    """

    halves: Float[np.ndarray, "2 P 3"]
    standard_error: Float[np.ndarray, "P 3"]

    @property
    def mean(self) -> Float[np.ndarray, "P 3"]:
        """Mean over all samples."""
        return self.halves.mean(axis=0)


def direct_irradiance(
    scene: Scene,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    lighting: Lighting,
    samples: int = 2,
    seed: int = 0,
    workers: int | None = None,
    flat: Float[np.ndarray, "P 3"] | None = None,
) -> Estimate:
    """Irradiance straight from the lights; without area and environment lights two samples are exact.

    `flat` are the normals of the points' faces where `normal` is tilted against them: nothing arrives from below.
    """
    paths, flat = _Paths(scene, lighting), normal if flat is None else flat
    return average(
        lambda rng, at: paths.direct(rng, position[at], normal[at], flat[at]), len(position), samples, seed, workers
    )


def indirect_irradiance(
    scene: Scene,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    lighting: Lighting,
    paths: int,
    bounces: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    flat: Float[np.ndarray, "P 3"] | None = None,
) -> Estimate:
    """Irradiance after at least one and at most `bounces` diffuse reflections (None: all, by Russian roulette).

    `paths` start at each point; the result is unbiased and does not depend on the number of workers. Normal images tilt
    the normals on the way; `flat` is that of `direct_irradiance`.
    """
    follow, flat = _Paths(scene, lighting), normal if flat is None else flat
    return average(
        lambda rng, at: follow.indirect(rng, position[at], normal[at], flat[at], bounces),
        len(position),
        paths,
        seed,
        workers,
    )


def leaving_light(
    scene: Scene,
    position: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    face: Int[np.ndarray, " P"],
    lighting: Lighting,
    paths: int,
    bounces: int | None = None,
    seed: int = 0,
    workers: int | None = None,
) -> Estimate:
    """Radiosity that leaves points on translucent `face`s, in W/m², but for the reflection of direct light: light that came
    in anywhere, direct and after up to `bounces` reflections or ways through bodies, and what is reflected of the latter."""
    follow = _Paths(scene, lighting)
    albedo = scene.albedo_at(face, np.full((len(face), 3), 1.0 / 3.0))

    def sample(rng: Generator, at: np.ndarray) -> np.ndarray:
        assert follow.media is not None, "no material holds a medium"
        place, out, weight = follow.media.through(rng, face[at], position[at], normal[at])
        reflected = albedo[at] * follow.indirect(rng, position[at], normal[at], normal[at], bounces)
        return reflected + weight * (
            follow.direct(rng, place, out, out) + follow.indirect(rng, place, out, out, bounces)
        )

    return average(sample, len(position), paths, seed, workers)


def average(
    sample: Callable[[Generator, Int[np.ndarray, " n"]], Float[np.ndarray, "n 3"]],
    points: int,
    count: int,
    seed: int,
    workers: int | None,
) -> Estimate:
    """Mean of `count` samples at each point; sample i of all points comes before sample i + 1 of any."""
    samples = max(count // 2, 1)
    per_half = samples * points
    starts = [(half, at) for half in (0, 1) for at in range(0, per_half, PATHS_AT_ONCE)]

    def moments(start: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        at = np.arange(start[1], min(start[1] + PATHS_AT_ONCE, per_half)) % points
        values = sample(np.random.default_rng((seed, *start)), at)
        return _sums_per_point(values, at, points), _sums_per_point(values**2, at, points)

    total, squares = np.zeros((2, points, 3)), np.zeros((points, 3))
    with ThreadPoolExecutor(workers or os.cpu_count()) as executor:
        for (half, _), (first, second) in zip(starts, executor.map(moments, starts), strict=True):
            total[half] += first
            squares += second
    halves = total / samples
    variance = np.maximum(squares / (2 * samples) - halves.mean(axis=0) ** 2, 0.0)
    return Estimate(halves, np.sqrt(variance / (2 * samples - 1)))


def _sums_per_point(values: np.ndarray, at: np.ndarray, points: int) -> Float[np.ndarray, "P 3"]:
    return np.stack([np.bincount(at, weights=channel, minlength=points) for channel in values.T], axis=1)


class _Paths:
    """Light paths in one scene under one lighting."""

    def __init__(self, scene: Scene, lighting: Lighting) -> None:
        if scene.strands is not None:
            raise SceneError(
                f"scene '{scene.name}' has hair, in which paths of the reference do not go; take the hair out"
            )
        self.scene = scene
        self.lights = lighting.lights
        self.tracer = Tracer(scene, workers=1)
        self.media = Media(scene) if scene.translucent else None
        self.two_sided = np.array([material.two_sided for material in scene.materials])[scene.mesh.material]
        self.epsilon = OFFSET * (scene.extent + float(np.abs(scene.bounds).max()))

    def direct(
        self, rng: Generator, position: np.ndarray, normal: np.ndarray, flat: np.ndarray
    ) -> Float[np.ndarray, "n 3"]:
        """One sample of every light, with a shadow ray each."""
        origin = position + self.epsilon * flat
        irradiance = np.zeros(position.shape)
        for light in self.lights:
            arrival = sample_light(light, origin, rng)
            incidence = np.maximum(np.einsum("nd,nd->n", arrival.direction, normal), 0.0)
            above = np.einsum("nd,nd->n", arrival.direction, flat) > 0
            value = arrival.strength * (incidence * above)[:, None]
            lit = np.flatnonzero(value.any(axis=1))
            reach = np.minimum(arrival.distance[lit], 4.0 * self.scene.extent)
            shadowed = self.tracer.occluded(origin[lit], arrival.direction[lit] * reach[:, None])
            irradiance[lit[~shadowed]] += value[lit[~shadowed]]
        return irradiance

    def indirect(
        self, rng: Generator, position: np.ndarray, normal: np.ndarray, flat: np.ndarray, bounces: int | None
    ) -> Float[np.ndarray, "n 3"]:
        """One path per point.

        E(p) = ∫ L cosθ dω is sampled with density cosθ/π, and L = ρ/π (E_dir + E) at the hit: a bounce multiplies by ρ.
        """
        irradiance = np.zeros(position.shape)
        weight = np.ones(position.shape)
        alive = np.arange(len(position))
        bounce = 0
        while len(alive) and bounce != bounces:
            bounce += 1
            met, position, normal, flat, albedo = self._next_surface(rng, position, normal, flat)
            alive, weight = alive[met], weight[met] * albedo
            irradiance[alive] += weight * self.direct(rng, position, normal, flat)
            if bounces is None and bounce >= ROULETTE_FROM:
                survival = np.minimum(weight.max(axis=1), 0.95)
                kept = rng.random(len(alive)) < survival
                alive, position, normal, flat = alive[kept], position[kept], normal[kept], flat[kept]
                weight = weight[kept] / survival[kept, None]
        return irradiance

    def _next_surface(
        self, rng: Generator, position: np.ndarray, normal: np.ndarray, flat: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Indices of the rays that meet a reflecting surface; position, both normals on the side met and albedo there.

        Where that is translucent, those may be of the place where light enters that comes out here, and its weight."""
        direction = cosine_directions(rng, normal)
        hits = self.tracer.intersect(position + self.epsilon * flat, direction)
        leaves = np.einsum("nd,nd->n", direction, flat) > 0  # else its own face hides what it would meet
        met = np.flatnonzero(leaves & (hits.face >= 0) & (hits.front | self.two_sided[hits.face]))
        face = hits.face[met]
        u, v = hits.u[met].astype(float), hits.v[met].astype(float)
        barycentric = np.stack([1.0 - u - v, u, v], axis=1)
        position = np.einsum("nc,ncd->nd", barycentric, self.scene.mesh.triangles[face])
        side = np.where(hits.front[met], 1.0, -1.0)[:, None]
        tilted, facing = side * self.scene.shading_normal_at(face, barycentric), side * self.scene.mesh.normals[face]
        albedo = self.scene.albedo_at(face, barycentric)
        if self.media is not None:
            position, tilted, facing, albedo = self.media.leave(rng, face, position, tilted, facing, albedo)
        return met, position, tilted, facing, albedo


class _Arrival(NamedTuple):
    """A sample of a light seen from n points: irradiance is `strength` times the cosine at the receiver."""

    direction: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    strength: Float[np.ndarray, "n 3"]


@singledispatch
def sample_light(light: Light, point: Float[np.ndarray, "n 3"], rng: Generator) -> _Arrival:
    """Direction, distance and strength of one random sample of a light from each point."""
    raise TypeError(f"the reference path tracer knows no {type(light).__name__}")


@sample_light.register
def _(light: PointLight, point: np.ndarray, rng: Generator) -> _Arrival:
    offset = np.asarray(light.position) - point
    distance = np.linalg.norm(offset, axis=1)
    strength = np.asarray(light.intensity) / (distance**2 + float(light.radius) ** 2)[:, None]
    return _Arrival(normalised(offset), distance, strength)


@sample_light.register
def _(light: SpotLight, point: np.ndarray, rng: Generator) -> _Arrival:
    arrival = sample_light(PointLight(light.position, light.intensity, light.radius), point, rng)
    cosine = -arrival.direction @ normalised(np.asarray(light.direction)[None])[0]
    edge, full = np.cos(float(light.cutoff)), np.cos(float(light.cutoff) * (1.0 - float(light.falloff)))
    t = np.clip((cosine - edge) / (full - edge), 0.0, 1.0)
    return arrival._replace(strength=arrival.strength * (3.0 * t**2 - 2.0 * t**3)[:, None])


@sample_light.register
def _(light: DirectionalLight, point: np.ndarray, rng: Generator) -> _Arrival:
    direction = np.broadcast_to(normalised(-np.asarray(light.direction)[None]), point.shape)
    strength = np.broadcast_to(np.asarray(light.irradiance), point.shape)
    return _Arrival(direction, np.full(len(point), np.inf), strength)


@sample_light.register
def _(light: RectLight, point: np.ndarray, rng: Generator) -> _Arrival:
    s, t = rng.uniform(-1.0, 1.0, (2, len(point), 1))
    u, v = np.asarray(light.u), np.asarray(light.v)
    offset = np.asarray(light.center) + s * u + t * v - point
    distance = np.linalg.norm(offset, axis=1)
    direction = normalised(offset)
    # dω = cosθ' dA / r², and ∫ dA over half-edges u, v is 4 |u × v|; the emitter's cosine absorbs one |u × v|.
    seen = np.maximum(-direction @ np.cross(u, v), 0.0) * 4.0 / distance**2
    return _Arrival(direction, distance, seen[:, None] * np.asarray(light.radiance))


@sample_light.register
def _(light: SphereLight, point: np.ndarray, rng: Generator) -> _Arrival:
    # Uniform over the cone the sphere subtends: sin α = r / d, solid angle 2π (1 − cos α). Nothing is seen from inside.
    offset = np.asarray(light.center) - point
    centre_distance = np.linalg.norm(offset, axis=1)
    sine = np.minimum(float(light.radius) / centre_distance, 1.0)
    versine = sine**2 / (1.0 + np.sqrt(1.0 - sine**2))
    cosine = 1.0 - rng.random(len(point)) * versine
    direction = about_axis(normalised(offset), cosine, rng.random(len(point)))
    half_chord = np.sqrt(np.maximum(float(light.radius) ** 2 - centre_distance**2 * (1.0 - cosine**2), 0.0))
    solid_angle = 2.0 * np.pi * np.where(sine < 1.0, versine, 0.0)
    return _Arrival(direction, centre_distance * cosine - half_chord, solid_angle[:, None] * np.asarray(light.radiance))


@sample_light.register
def _(light: EnvironmentLight, point: np.ndarray, rng: Generator) -> _Arrival:
    height, width = light.map.radiance.shape[:2]
    cumulative, irradiance = environment_table(light.map)
    texel = np.searchsorted(cumulative, rng.random(len(point)), side="right")
    row, column = np.divmod(texel, width)
    # Uniform inside the texel: in azimuth, and in the cosine of the polar angle.
    top, bottom = np.cos(np.pi * row / height), np.cos(np.pi * (row + 1) / height)
    y = top + (bottom - top) * rng.random(len(point))
    azimuth = 2.0 * np.pi * ((column + rng.random(len(point))) / width - 0.5)
    ring = np.sqrt(np.maximum(1.0 - y**2, 0.0))
    direction = np.stack([ring * np.sin(azimuth), y, -ring * np.cos(azimuth)], axis=1)
    turned = Rotation.from_rotvec(light.rotation.tolist()).apply(direction)
    return _Arrival(turned, np.full(len(point), np.inf), irradiance[texel])


@lru_cache(maxsize=8)
def environment_table(
    environment: EnvironmentMap,
) -> tuple[Float[np.ndarray, " texels"], Float[np.ndarray, "texels 3"]]:
    """Cumulative probability of texels by their power, and each one's irradiance over its probability."""
    height, width = environment.radiance.shape[:2]
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    solid_angle = (edges[:-1] - edges[1:]) * 2.0 * np.pi / width
    irradiance = (environment.radiance.astype(float) * solid_angle[:, None, None]).reshape(-1, 3)
    power = irradiance.sum(axis=1)
    probability = power / power.sum() if power.any() else np.full(len(power), 1.0 / len(power))
    cumulative = np.cumsum(probability)
    return cumulative / cumulative[-1], irradiance / np.maximum(probability, np.finfo(float).tiny)[:, None]


def cosine_directions(rng: Generator, normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vectors about normals with density cosθ/π."""
    return about_axis(normal, np.sqrt(1.0 - rng.random(len(normal))), rng.random(len(normal)))


def about_axis(axis: np.ndarray, cosine: np.ndarray, turn: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Unit vectors at given cosines to unit axes, `turn` of a full turn around them."""
    # Two tangents by Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
    x, y, z = axis.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    around = 2.0 * np.pi * turn
    return (sine * np.cos(around))[:, None] * first + (sine * np.sin(around))[:, None] * second + cosine[:, None] * axis


def normalised(vector: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vectors along the given ones."""
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)
