"""Light through translucent bodies in the independent path tracer, by another estimator than the bake's walks.

A path goes on inside in directions of the interior cosine, weighted by what Fresnel lets in; it flies to the next scattering,
and absorption weighs it along the way. So refraction, absorption and the weights of the two meet only in their expectation.
Of `data_gen/medium_walk.py` nothing is used.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from data_gen.tracer import Tracer
from prt_bench.medium import Subsurface
from prt_bench.scene import Mesh, Scene

_FAINT = 0.1  # weight from which Russian roulette ends paths
_INSIDE = 1e-6  # how far below a surface a path begins, relative to the body


class Media:
    """The bodies of a scene."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._bodies = {
            index: _Body(scene, index)
            for index in np.unique(scene.mesh.material)
            if scene.materials[index].subsurface is not None
        }

    def leave(
        self,
        rng: Generator,
        face: Int[np.ndarray, " n"],
        position: Float[np.ndarray, "n 3"],
        normal: Float[np.ndarray, "n 3"],
        flat: Float[np.ndarray, "n 3"],
        albedo: Float[np.ndarray, "n 3"],
    ) -> tuple[np.ndarray, ...]:
        """Where paths that met surfaces receive light: position, both normals, and the factor that takes it to what leaves.

        That is the same place and the albedo on opaque surfaces. On translucent ones a path that is reflected, one of two where
        anything is, stays too; any other goes through the body.
        """
        position, normal, flat, factor = position.copy(), normal.copy(), flat.copy(), albedo.copy()
        owner = self._scene.mesh.material[face]
        for index, body in self._bodies.items():
            here = np.flatnonzero(owner == index)
            reflects = self._scene.materials[index].albedo != (0.0, 0.0, 0.0)
            stays = rng.random(len(here)) < 0.5 * reflects
            factor[here[stays]] *= 2.0
            inside = here[~stays]
            place, out, weight = body.cross(rng, position[inside], flat[inside])
            position[inside], normal[inside], flat[inside] = place, out, out
            factor[inside] = (1.0 + reflects) * weight
        return position, normal, flat, factor

    def through(
        self,
        rng: Generator,
        face: Int[np.ndarray, " n"],
        position: Float[np.ndarray, "n 3"],
        flat: Float[np.ndarray, "n 3"],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where light came in that leaves translucent points, the normals there, and its weight by channel."""
        at, out, weight = position.copy(), flat.copy(), np.zeros(position.shape)
        owner = self._scene.mesh.material[face]
        for index, body in self._bodies.items():
            here = np.flatnonzero(owner == index)
            at[here], out[here], weight[here] = body.cross(rng, position[here], flat[here])
        return at, out, weight


class _Body:
    """The surfaces of one material, about their middle."""

    def __init__(self, scene: Scene, index: int) -> None:
        medium = scene.materials[index].subsurface
        assert medium is not None
        self.medium: Subsurface = medium
        chosen = scene.mesh.material == index
        self.middle = scene.mesh.triangles[chosen].mean((0, 1))
        mesh = Mesh(scene.mesh.vertices - self.middle, scene.mesh.faces[chosen], scene.mesh.material[chosen])
        alone = replace(scene, mesh=mesh)
        self.normals, self.extent, self.tracer = mesh.normals, alone.extent, Tracer(alone, workers=1)

    def cross(
        self, rng: Generator, position: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Paths from the surface through the body: where they come out, normals there, and weights, 0 for those that do not."""
        count, eta = len(position), self.medium.ior
        where, out, total = position.copy(), normal.copy(), np.zeros((count, 3))
        channel = np.zeros(count, int) if self.medium.grey else rng.integers(3, size=count)
        scattering, absorption = (
            np.asarray(part, float)[channel] for part in (self.medium.scattering, self.medium.absorption)
        )
        height = np.sqrt(rng.random(count))  # of the cosine over the whole inner hemisphere
        direction = _turned(-normal, height, rng.random(count))
        # Radiance grows by η² as it enters; beyond the critical angle none does.
        weight = eta**2 * (1.0 - _reflectance(height, eta))
        alive = np.flatnonzero(weight > 0)
        place = position - self.middle - _INSIDE * self.extent * normal
        place, direction, weight = place[alive], direction[alive], weight[alive]
        while len(alive):
            flight = np.full(len(alive), np.inf)
            scatters = scattering[alive] > 0
            flight[scatters] = rng.exponential(1.0 / scattering[alive[scatters]])
            hits = self.tracer.intersect(place, direction)
            at_wall = hits.distance < flight
            length = np.where(at_wall, hits.distance, flight)
            sound = np.isfinite(length)  # else it slipped out between two triangles
            length = np.where(sound, length, 0.0)
            place = place + length[:, None] * direction
            weight = weight * np.exp(-absorption[alive] * length)
            goes_on = sound.copy()

            some = np.flatnonzero(sound & ~at_wall)
            direction[some] = _turned(
                direction[some], _phase(self.medium.anisotropy, rng.random(len(some))), rng.random(len(some))
            )
            some = np.flatnonzero(sound & at_wall)
            wall = self.normals[hits.face[some]]
            cosine = np.einsum("nd,nd->n", direction[some], wall)
            some, wall, cosine = some[cosine > 0], wall[cosine > 0], cosine[cosine > 0]
            leaves = rng.random(len(some)) >= _reflectance(np.minimum(cosine, 1.0), eta)
            gone, back = some[leaves], some[~leaves]
            paths = alive[gone]
            where[paths], out[paths] = place[gone] + self.middle, wall[leaves]
            if self.medium.grey:
                total[paths] = weight[gone, None]
            else:
                total[paths, channel[paths]] = 3.0 * weight[gone]
            goes_on[gone] = False
            direction[back] -= 2.0 * cosine[~leaves, None] * wall[~leaves]
            place[back] -= _INSIDE * self.extent * wall[~leaves]

            survival = np.where(weight < _FAINT, weight / _FAINT, 1.0)
            goes_on &= rng.random(len(alive)) < survival
            weight = weight / np.where(survival > 0, survival, 1.0)
            alive, place, direction, weight = alive[goes_on], place[goes_on], direction[goes_on], weight[goes_on]
        return where, out, total


def _reflectance(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Fresnel reflectance at the boundary from within a medium of index `eta`, in sines and tangents of both angles."""
    if eta == 1:
        return np.zeros_like(cosine)
    inner = np.arccos(np.clip(cosine, 0.0, 1.0))
    sine = eta * np.sin(inner)
    outer = np.arcsin(np.minimum(sine, 1.0))
    near = inner < 1e-4  # both ratios below turn 0 / 0 at normal incidence
    across, along = inner + outer, np.where(near, 1.0, inner - outer)
    both = np.where(near, 1.0, across)
    s = (np.sin(along) / np.sin(both)) ** 2
    p = (np.tan(along) / np.tan(both)) ** 2
    return np.where(sine >= 1, 1.0, np.where(near, ((eta - 1.0) / (eta + 1.0)) ** 2, 0.5 * (s + p)))


def _phase(g: float, u: np.ndarray) -> np.ndarray:
    """Cosines of Henyey and Greenstein's scattering angle."""
    s = 2.0 * u - 1.0
    if abs(g) < 1e-6:
        return s
    return np.clip((1.0 + g**2 - ((1.0 - g**2) / (1.0 + g * s)) ** 2) / (2.0 * g), -1.0, 1.0)


def _turned(axis: np.ndarray, cosine: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit vectors at cosines to unit axes, by a random tangent."""
    helper = np.where(np.abs(axis[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    x, y = sine * np.cos(2.0 * np.pi * turn), sine * np.sin(2.0 * np.pi * turn)
    turned = x[:, None] * first + y[:, None] * second + cosine[:, None] * axis
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
