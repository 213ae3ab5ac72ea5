"""Rays against a scene's triangles: embree behind NumPy arrays, on all cores.

Finds hits and visibility; knows nothing of light. Origins are moved off the surface by an offset that scales with the
magnitude of the coordinates, so the same scene at any scale gives the same hits.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from prt_bench.scene import Scene

RAYS_PER_CALL = 1 << 16
"""Rays handed to embree at once: enough to amortise the call, few enough to stay in cache."""
_OFFSET = 2.0**-14
"""Ray offset relative to the scene's size: 64 units in the last place of float32 at the far corner, and some room."""


@dataclass(frozen=True)
class Hits:
    """Nearest intersections: face [n] (−1 for a miss), barycentric u, v of corners 1 and 2, distance [n] (inf for a miss)
    and whether the face was met from its front."""

    face: Int[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    front: Bool[np.ndarray, " n"]


class Tracer:
    """Ray queries on one scene. Deterministic: the answer does not depend on the number of workers.

    `nearest` and `shadow` count the rays cast so far, those that look for the nearest hit and those that look for any.
    """

    def __init__(self, scene: Scene, workers: int | None = None) -> None:
        self.workers = workers or os.cpu_count() or 1
        self.offset = _OFFSET * max(float(np.abs(scene.bounds).max()), scene.extent)
        self.reach = 4.0 * scene.extent
        self.nearest = self.shadow = 0
        self._counting = Lock()
        self._embree = EmbreeScene()
        self._mesh = TriangleMesh(self._embree, np.ascontiguousarray(scene.mesh.triangles, np.float32))

    @contextmanager
    def pool(self, spare: bool = False) -> Iterator[Executor]:
        """Worker threads; embree releases Python's lock while it traces.

        `spare`: three threads more, which trace while others wait for a JAX kernel; none where one worker is asked for.
        """
        with ThreadPoolExecutor(self.workers + 3 * (spare and self.workers > 1)) as executor:
            yield executor

    def intersect(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
        """Nearest hit of each ray, with no offset applied."""
        origins, directions = np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)
        parts = self._in_parts(len(origins), lambda part: self._hits(origins[part], directions[part]))
        return Hits(*(np.concatenate([getattr(p, name) for p in parts]) for name in Hits.__dataclass_fields__))

    def occluded(self, origins: Float[np.ndarray, "n 3"], segments: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether anything lies between each origin and origin + segment, with no offset applied; on the calling thread."""
        origins, segments = np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(segments, np.float32)
        hidden = np.empty(len(origins), bool)
        with self._counting:
            self.shadow += len(origins)
        for at in range(0, len(origins), RAYS_PER_CALL):
            part = slice(at, at + RAYS_PER_CALL)
            reach = np.ones(len(origins[part]), np.float32)
            hidden[part] = self._embree.run(origins[part], segments[part], reach, query="OCCLUDED") == 0
        return hidden

    def inside(self, points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
        """Whether points lie inside solid geometry: most of the surfaces seen from there show their back."""
        hits = self._look_around(points)
        back = np.sum(np.isfinite(hits.distance) & ~hits.front, axis=1)
        return back > _DIRECTIONS.shape[0] // 2

    def clearance(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
        """Distance to the nearest surface over a fixed set of directions (inf where none is seen), in metres."""
        return self._look_around(points).distance.min(axis=1)

    def _look_around(self, points: np.ndarray) -> Hits:
        count = _DIRECTIONS.shape[0]
        hits = self.intersect(np.repeat(points, count, axis=0), np.tile(_DIRECTIONS, (len(points), 1)))
        return Hits(*(getattr(hits, name).reshape(-1, count) for name in Hits.__dataclass_fields__))

    def trace(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"] | None = None,
    ) -> dict[str, np.ndarray]:
        """Embree's own answer to float32 rays, on the calling thread: primID, u, v, tfar and the normal Ng (not unit).

        `reach` is how far each ray looks, in lengths of its direction; near ends make short work of the rest.
        """
        with self._counting:
            self.nearest += len(origins)
        return self._embree.run(origins, directions, reach, output=True)

    def _hits(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        found = self.trace(origins, directions)
        hit = found["primID"] >= 0
        front = hit & (np.einsum("nd,nd->n", found["Ng"], directions) < 0)
        return Hits(found["primID"], found["u"], found["v"], np.where(hit, found["tfar"], np.float32(np.inf)), front)

    def _in_parts(self, count: int, work: Callable[[slice], Any]) -> list[Any]:
        parts = [slice(at, min(at + RAYS_PER_CALL, count)) for at in range(0, max(count, 1), RAYS_PER_CALL)]
        if self.workers == 1 or len(parts) == 1:
            return [work(part) for part in parts]
        with self.pool() as executor:
            return list(executor.map(work, parts))


def _sphere_directions(count: int) -> Float[np.ndarray, "n 3"]:
    index = np.arange(count) + 0.5
    y, angle = 1.0 - 2.0 * index / count, np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - y**2)
    return np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1).astype(np.float32)


_DIRECTIONS = _sphere_directions(64)
