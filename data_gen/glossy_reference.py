"""Outgoing radiance by an independent path tracer: what glossy transfer must agree with.

The reflection is that of `prt_bench.scene.Glossy`. A vertex of a path samples every light and one direction, cosine or lobe
by turns, and weighs the two against each other, so that neither sharp lobes nor small lights leave rare bright samples
(balance heuristic: Veach and Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering"). Normal images
tilt the normals; a face hides what lies below itself, as in the bake. Diffuse irradiance is in `reference.py`, pictures are in
`reference_image.py`.
"""

from functools import singledispatch
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from data_gen.reference import (
    OFFSET,
    ROULETTE_FROM,
    Estimate,
    about_axis,
    average,
    cosine_directions,
    environment_table,
    sample_light,
)
from data_gen.tracer import Hits, Tracer
from prt_bench.errors import SceneError
from prt_bench.lights import EnvironmentLight, Light, Lighting, RectLight, SphereLight
from prt_bench.points import SurfacePoints
from prt_bench.scene import Scene

_EXTENDED = (RectLight, SphereLight, EnvironmentLight)


def reference_radiance(
    scene: Scene,
    lighting: Lighting,
    points: SurfacePoints,
    towards_eye: Float[np.ndarray, "P 3"],
    paths: int,
    bounces: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    diffuse_between: bool = False,
) -> Estimate:
    """Radiance that P points reflect along unit directions `towards_eye`, after direct light and up to `bounces` more.

    With `bounces` 0 it is that of direct light, with None all, by Russian roulette. `paths` start at each point; the result
    is unbiased and does not depend on the number of workers. A point is black towards directions behind its face.
    With `diffuse_between`, surfaces that light meets on its way to the points reflect it diffusely only, as a diffuse
    lightmap stores it: the lobe of the last reflection is then the only one.
    """
    follow = _GlossyPaths(scene, lighting, diffuse_between)
    specular, exponent = scene.glossy_at(points.face, points.barycentric)
    eye = np.asarray(towards_eye, float)
    start = _Vertex(points.position, points.normal, _flat(scene, points), eye, points.albedo, specular, exponent)
    return average(lambda rng, at: follow.radiance(rng, start.of(at), bounces), len(points), paths, seed, workers)


class _Vertex(NamedTuple):
    """n vertices of paths: where, facing normals of the surface and of its face, unit direction towards the viewer, and what
    the surface reflects."""

    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    flat: Float[np.ndarray, "n 3"]
    eye: Float[np.ndarray, "n 3"]
    albedo: Float[np.ndarray, "n 3"]
    specular: Float[np.ndarray, "n 3"]
    exponent: Float[np.ndarray, " n"]

    def of(self, at: np.ndarray) -> "_Vertex":
        return _Vertex(*(part[at] for part in self))

    @property
    def mirror(self) -> Float[np.ndarray, "n 3"]:
        return 2.0 * np.einsum("nd,nd->n", self.normal, self.eye)[:, None] * self.normal - self.eye

    @property
    def lobe_share(self) -> Float[np.ndarray, " n"]:
        """Probability of sampling the lobe."""
        lobe, both = self.specular.sum(axis=1), (self.specular + self.albedo).sum(axis=1)
        return np.divide(lobe, both, out=np.zeros_like(lobe), where=both > 0)

    def reflect(self, direction: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Reflectance times cosine for light from unit directions, and the density with which `sample` draws those."""
        cosine = np.maximum(np.einsum("nd,nd->n", direction, self.normal), 0.0)
        open_to = np.einsum("nd,nd->n", direction, self.flat) > 0
        aligned = np.einsum("nd,nd->n", direction, self.mirror)
        lobe = np.where(aligned > 0, np.maximum(aligned, 0.0) ** self.exponent, 0.0) * (self.exponent + 1) / (2 * np.pi)
        value = (self.albedo / np.pi + self.specular * lobe[:, None]) * (cosine * open_to)[:, None]
        share = self.lobe_share
        return value, share * lobe + (1.0 - share) * cosine / np.pi

    def sample(self, rng: Generator) -> Float[np.ndarray, "n 3"]:
        """A unit direction from each vertex, by cosine or by lobe; the latter may point below the surface."""
        around = cosine_directions(rng, self.normal)
        aligned = (1.0 - rng.random(len(around))) ** (1.0 / (self.exponent + 1.0))
        lobe = about_axis(self.mirror, np.minimum(aligned, 1.0), rng.random(len(around)))
        return np.where((rng.random(len(around)) < self.lobe_share)[:, None], lobe, around)


class _GlossyPaths:
    """Light paths in one scene under one lighting, followed from the eye."""

    def __init__(self, scene: Scene, lighting: Lighting, diffuse_between: bool) -> None:
        if scene.translucent:
            raise SceneError(
                f"scene '{scene.name}' has translucent bodies, through which paths of the glossy reference do not go; take"
                " their medium or the lobes out"
            )
        self.scene = scene
        self.lights = lighting.lights
        self.extended = [light for light in self.lights if isinstance(light, _EXTENDED)]
        self.diffuse_between = diffuse_between
        self.tracer = Tracer(scene, workers=1)
        self.epsilon = OFFSET * (scene.extent + float(np.abs(scene.bounds).max()))

    def radiance(self, rng: Generator, start: _Vertex, bounces: int | None) -> Float[np.ndarray, "n 3"]:
        """One path from each start."""
        total = np.zeros(start.position.shape)
        alive = np.flatnonzero(np.einsum("nd,nd->n", start.flat, start.eye) > 0)
        vertex, weight, bounce = start.of(alive), np.ones((len(alive), 3)), 0
        while len(alive):
            origin = vertex.position + self.epsilon * vertex.flat
            total[alive] += weight * self._lights_sampled(rng, vertex, origin)
            if bounce == bounces and not self.extended:
                break
            direction = vertex.sample(rng)
            value, density = vertex.reflect(direction)
            up = np.flatnonzero(value.any(axis=1))
            alive, weight, origin, direction = alive[up], weight[up], origin[up], direction[up]
            value, density = value[up], density[up]
            hits = self.tracer.intersect(origin, direction)
            for light in self.extended:
                met = arriving(light, origin, direction)
                seen = (hits.distance > met.distance) | ~np.isfinite(hits.distance)
                factor = np.where(seen, 1.0 / (met.density + density), 0.0)[:, None]
                total[alive] += weight * value * met.radiance * factor
            if bounce == bounces:
                break
            bounce += 1
            met = np.flatnonzero(hits.face >= 0)
            met = met[reflecting(self.scene, hits, met)]
            alive, weight = alive[met], weight[met] * value[met] / density[met, None]
            points = surface_met(self.scene, hits, met)
            specular, exponent = self.scene.glossy_at(points.face, points.barycentric)
            if self.diffuse_between:
                specular, exponent = np.zeros_like(specular), np.zeros_like(exponent)
            flat, eye = _flat(self.scene, points), -direction[met]
            vertex = _Vertex(points.position, points.normal, flat, eye, points.albedo, specular, exponent)
            if bounces is None and bounce >= ROULETTE_FROM:
                survival = np.minimum((weight * (points.albedo + specular)).max(axis=1), 0.95)
                kept = rng.random(len(alive)) < survival
                alive, vertex, weight = alive[kept], vertex.of(kept), weight[kept] / survival[kept, None]
        return total

    def _lights_sampled(self, rng: Generator, vertex: _Vertex, origin: np.ndarray) -> Float[np.ndarray, "n 3"]:
        """Reflected radiance from one sample of every light; extended ones share with sampled directions."""
        radiance = np.zeros(origin.shape)
        for light in self.lights:
            arrival = sample_light(light, origin, rng)
            value, density = vertex.reflect(arrival.direction)
            value = value * arrival.strength
            if isinstance(light, _EXTENDED):
                own = arriving(light, origin, arrival.direction).density
                value = value * np.divide(own, own + density, out=np.zeros_like(own), where=own > 0)[:, None]
            lit = np.flatnonzero(value.any(axis=1))
            reach = np.minimum(arrival.distance[lit], 4.0 * self.scene.extent)
            shadowed = self.tracer.occluded(origin[lit], arrival.direction[lit] * reach[:, None])
            radiance[lit[~shadowed]] += value[lit[~shadowed]]
        return radiance


def reflecting(scene: Scene, hits: Hits, at: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether surfaces were met on a side that reflects."""
    two_sided = np.array([material.two_sided for material in scene.materials])
    return hits.front[at] | two_sided[scene.mesh.material[hits.face[at]]]


def surface_met(scene: Scene, hits: Hits, at: Int[np.ndarray, " n"]) -> SurfacePoints:
    """The points that rays met, with normals of the side that was met."""
    face, u, v = hits.face[at], hits.u[at].astype(float), hits.v[at].astype(float)
    barycentric = np.stack([1.0 - u - v, u, v], axis=1)
    position = np.einsum("nc,ncd->nd", barycentric, scene.mesh.triangles[face])
    facing = np.where(hits.front[at], 1.0, -1.0)[:, None] * scene.shading_normal_at(face, barycentric)
    return SurfacePoints(position, facing, scene.albedo_at(face, barycentric), face, barycentric)


def _flat(scene: Scene, points: SurfacePoints) -> Float[np.ndarray, "P 3"]:
    """Normals of the points' faces, on the side of the points' own."""
    flat = scene.mesh.normals[points.face]
    return np.where(np.einsum("pd,pd->p", flat, points.normal)[:, None] < 0, -flat, flat)


class _Arriving(NamedTuple):
    """What n rays meet of a light: radiance, its distance, and the density per solid angle with which it is sampled."""

    radiance: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    density: Float[np.ndarray, " n"]


@singledispatch
def arriving(light: Light, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> _Arriving:
    """What arrives of an extended light along rays where nothing stands between, and how `sample_light` would choose them."""
    raise TypeError(f"no ray can meet a {type(light).__name__}")


@arriving.register
def _(light: RectLight, origin: np.ndarray, direction: np.ndarray) -> _Arriving:
    u, v = np.asarray(light.u, float), np.asarray(light.v, float)
    axis = np.cross(u, v)  # the way it shines; as long as a quarter of its area
    towards = -direction @ axis
    facing = towards > 0
    safe = np.where(facing, towards, 1.0)
    offset = np.asarray(light.center, float) - origin
    distance = -(offset @ axis) / safe
    place = distance[:, None] * direction - offset
    s, t = np.cross(place, v) @ axis / (axis @ axis), np.cross(u, place) @ axis / (axis @ axis)
    inside = facing & (distance > 0) & (np.abs(s) <= 1) & (np.abs(t) <= 1)
    return _Arriving(
        np.where(inside[:, None], np.asarray(light.radiance, float), 0.0),
        np.where(inside, distance, np.inf),
        np.where(inside, distance**2 / (4.0 * safe), 0.0),
    )


@arriving.register
def _(light: SphereLight, origin: np.ndarray, direction: np.ndarray) -> _Arriving:
    offset = np.asarray(light.center, float) - origin
    centre = np.linalg.norm(offset, axis=1)
    radius = float(light.radius)
    sine = np.minimum(radius / centre, 1.0)
    versine = sine**2 / (1.0 + np.sqrt(1.0 - sine**2))
    along = np.einsum("nd,nd->n", offset, direction)
    inside = (sine < 1) & (along / centre >= 1.0 - versine)
    half_chord = np.sqrt(np.maximum(radius**2 - centre**2 + along**2, 0.0))
    return _Arriving(
        np.where(inside[:, None], np.asarray(light.radiance, float), 0.0),
        np.where(inside, along - half_chord, np.inf),
        np.where(inside, 1.0 / (2.0 * np.pi * versine), 0.0),
    )


@arriving.register
def _(light: EnvironmentLight, origin: np.ndarray, direction: np.ndarray) -> _Arriving:
    height, width = light.map.radiance.shape[:2]
    x, y, z = Rotation.from_rotvec(np.asarray(light.rotation).tolist()).inv().apply(direction).T
    row = np.minimum((np.arccos(np.clip(y, -1.0, 1.0)) / np.pi * height).astype(int), height - 1)
    column = np.minimum(((np.arctan2(x, -z) / (2.0 * np.pi) + 0.5) * width).astype(int), width - 1)
    probability = np.diff(environment_table(light.map)[0], prepend=0.0)[row * width + column]
    solid_angle = (np.cos(np.pi * row / height) - np.cos(np.pi * (row + 1) / height)) * 2.0 * np.pi / width
    radiance = light.map.radiance[row, column].astype(float)
    return _Arriving(radiance, np.full(len(origin), np.inf), probability / solid_angle)
