"""Walks in translucent bodies: energy at any albedo, depth and size, free paths, narrow phase functions, open bodies."""

from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import trimesh

from data_gen import medium_walk
from data_gen.effects.subsurface import media
from data_gen.medium_walk import Fate
from data_gen.reference import cosine_directions
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.routes import F32, F64, Route

_WALKS = 4000
_DEVIATIONS = 5.0
_BLACK = (0.0, 0.0, 0.0)


class Ball(NamedTuple):
    """A medium in a ball: single-scattering albedo, radius over the mean free path, mean cosine, index, radius in metres."""

    albedo: float = 1.0
    depth: float = 1.0
    anisotropy: float = 0.0
    ior: float = 1.3
    radius: float = 1.0

    def scene(self) -> Scene:
        """The ball alone."""
        made = trimesh.creation.icosphere(subdivisions=3, radius=self.radius)
        medium = Subsurface.of_albedo((self.albedo,) * 3, (self.radius / self.depth,) * 3, self.anisotropy, self.ior)
        mesh = Mesh(made.vertices, made.faces, np.zeros(len(made.faces), int))
        camera = Camera((0, 0, 4 * self.radius), (0, 0, 0))
        return Scene("ball", mesh, (Material("wax", _BLACK, subsurface=medium),), camera)


def walks() -> dict[str, ModuleType]:
    """The module, whose functions are looked up when they are called."""
    return {"walks": medium_walk}


def _fates(tested: Any, ball: Ball) -> np.ndarray:
    """Share of each fate, among walks from all over the ball."""
    scene, rng = ball.scene(), np.random.default_rng(0)
    face = rng.choice(len(scene.mesh.faces), _WALKS, p=scene.mesh.areas / scene.mesh.areas.sum())
    position = np.einsum("nc,ncd->nd", rng.dirichlet([1, 1, 1], _WALKS), scene.mesh.triangles[face])
    normal = scene.mesh.normals[face]
    keys = tested.walk_keys(np.arange(_WALKS), 1, 0)[:, 0]
    body = tested.bodies(scene, 1)[0]
    ends = tested.follow(body, 0, position, normal, cosine_directions(rng, normal), keys)
    return np.bincount(ends.fate, minlength=len(Fate)) / _WALKS


def _balls(route: Route) -> Iterator[Member]:
    plain = Ball()
    for albedo in (1.0, 1.0 - 1e-6, 0.0):
        yield Member(f"albedo {albedo:g}", plain._replace(albedo=albedo))
    for depth in (1e-3, 100.0, 1e3):
        yield Member(f"{depth:g} mean free paths", plain._replace(depth=depth))
    for anisotropy in (-0.99, 0.99):
        yield Member(f"mean cosine {anisotropy:g}", plain._replace(anisotropy=anisotropy, depth=10.0))
    for ior in (1.0, 2.5):
        yield Member(f"index {ior:g}", plain._replace(ior=ior))
    for radius in (1e-3, 1e4):
        yield Member(f"radius {radius:g} m", plain._replace(radius=radius))


@case("F3", "walks end, and none is lost", subjects=walks, family=_balls, routes=(F32,))
def energy(tested: Any, ball: Ball, route: Route) -> Iterator[Measured]:
    """F3: walks that stop after 64 steps lose a fifth of the light of a deep medium that absorbs nothing.

    Few are given up, even 1000 mean free paths deep; the boundary reflects what Fresnel says, nothing is absorbed where
    nothing absorbs, size alone changes nothing, and a body without scattering passes what Beer and Lambert say.
    """
    found = _fates(tested, ball)
    yield Measured(float(found[Fate.LOST]), 1e-3)
    yield Measured(float(found[Fate.ALIVE]), 1e-2)
    reflected = Subsurface(ior=ball.ior).reflected
    yield Measured(abs(float(found[Fate.REFLECTED]) - reflected), _DEVIATIONS * _deviation(reflected))
    if ball.albedo == 1.0:
        yield Measured(float(found[Fate.ABSORBED]), 0.0)
    plain = _fates(tested, ball._replace(radius=1.0))
    yield Measured(float(np.abs(found - plain).max()), _DEVIATIONS * _deviation(0.5))
    # Chords of a sphere from diffuse light are 2 R μ long, μ the cosine at which they start.
    clear = _fates(tested, Ball(0.0, ball.depth, ior=1.0, radius=ball.radius))
    twice = 2.0 * ball.depth
    passed = -2.0 * (np.expm1(-twice) + twice * np.exp(-twice)) / twice**2
    # A ball of flat faces holds chords up to a hundredth shorter.
    yield Measured(abs(float(clear[Fate.ESCAPED]) - passed), _DEVIATIONS * _deviation(passed) + 0.01)


def _deviation(share: float) -> float:
    return float(np.sqrt(max(share * (1.0 - share), 0.0) / _WALKS))


def _draws(route: Route) -> Iterator[Member]:
    unit = 2.0**-53
    yield Member("every size of u", np.concatenate([[0.0, unit], np.geomspace(unit, 0.5, 200)]))
    yield Member("u close to 1", 1.0 - np.arange(1, 200) * unit)


@case("F3d", "free paths of any random number", subjects=walks, family=_draws, routes=(F64,))
def free_path(tested: Any, draw: np.ndarray, route: Route) -> Iterator[Measured]:
    """F3d: −log u is infinite at u = 0, which is drawn. The share of longer paths, e^−s, is 1 − u."""
    length = tested.free_paths(draw, 3.0)
    yield Measured(float(np.max(np.abs(-np.expm1(-3.0 * length) - draw))), 4 * route.eps)
    yield Measured(float(np.sum(length < 0)), 0.0)


def _cosines(route: Route) -> Iterator[Member]:
    return (Member(f"mean cosine {g:g}", g) for g in (-0.99, -0.5, -1.1e-3, -1e-9, 0.0, 9e-4, 0.3, 0.99))


@case("F3", "narrow phase functions", subjects=walks, family=_cosines, routes=(F64,))
def phase(tested: Any, anisotropy: float, route: Route) -> Iterator[Measured]:
    """The mean cosine is the anisotropy, however narrow, and through 0, where the usual inverse divides by it."""
    count = 1 << 14
    first, second = (np.arange(count) + 0.5) / count, np.random.default_rng(0).uniform(size=count)
    along = np.tile([0.6, 0.0, 0.8], (count, 1))
    turned = tested.scattered(along, anisotropy, first, second)
    yield Measured(float(np.abs(np.linalg.norm(turned, axis=1) - 1).max()), 30 * route.eps)
    yield Measured(abs(float(np.mean(turned @ along[0])) - anisotropy), 1e-4)


def _open(route: Route) -> Iterator[Member]:
    scene = Ball().scene()
    mesh = scene.mesh
    yield Member("a face is missing", replace(scene, mesh=Mesh(mesh.vertices, mesh.faces[1:], mesh.material[1:])))
    yield Member("inside out", replace(scene, mesh=Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.material)))
    flat = Mesh(mesh.vertices * np.array([1.0, 1.0, 0.0]), mesh.faces, mesh.material)
    yield Member("without a volume", replace(scene, mesh=flat))


@case("F3", "a medium needs a closed body", kind=Kind.REFUSAL, subjects=walks, family=_open, routes=(F64,))
def closed(tested: Any, scene: Scene, route: Route) -> bool:
    """F3: walks in an open body leave through the hole and never come back."""
    return media(scene) == []
