"""Subsurface scattering: a sparse, light-independent map from irradiance at gather samples to what leaves translucent points.

Walks (`data_gen/medium_walk.py`) are traced once from each such point and resolved to the samples where they end. So a walk is
one index in a hit table, like a ray, and each channel has walks of its own where the medium is not grey. Checks of what can be
walked in, what it is predicted to cost, and the tables in the store are here; their use is `prt_bench.transport.Scattering`.
"""

import json
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import zarr
from jaxtyping import Float, Int

from data_gen.geometry import Part, is_closed
from data_gen.journal import Journal, create_array
from data_gen.medium_walk import LONGEST, Body, Ends, Fate, bodies, follow_all, walk_keys
from data_gen.resolve import HitResolver
from prt_bench.errors import SceneError
from prt_bench.hemisphere import HemisphereSampler, hashed
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.progress import say, track
from prt_bench.scene import Scene
from prt_bench.store import write_array

VERSION = 1  # part of the transport's key: raise when the same inputs would give other walks
_POINTS = 1 << 11  # translucent points whose walks are traced and stored together
_PILOT_POINTS, _PILOT_WALKS = 512, 32  # that are followed to predict what all of them cost
_PLACE = np.uint64(6)  # chooses the jitter of a walk's end


def media(scene: Scene) -> list[int]:
    """Indices of the materials that hold a medium, all of whose faces are closed. Raises `SceneError` where they are not."""
    if not scene.translucent:
        return []
    found = [int(i) for i in np.unique(scene.mesh.material) if scene.materials[i].subsurface is not None]
    for index in found:
        check_closed(scene, index)
    return found


def check_closed(scene: Scene, material: int) -> None:
    """Raise `SceneError` unless the faces of a translucent material enclose a volume."""
    faces = scene.mesh.faces[scene.mesh.material == material]
    if not is_closed(Part(scene.mesh.vertices, faces, material)) or enclosed_volume(scene, material) <= 0:
        raise SceneError(
            f"material '{scene.materials[material].name}' of scene '{scene.name}' holds a medium, but its faces do not enclose"
            " a volume, fronts outward; close the mesh, or take the medium out"
        )


def enclosed_volume(scene: Scene, material: int) -> float:
    """Volume within the faces of a material in m³, by the divergence theorem."""
    triangles = scene.mesh.triangles[scene.mesh.material == material]
    middle = triangles.mean(axis=(0, 1))
    return float(np.sum(np.linalg.det(triangles - middle)) / 6.0)


def predicted_events(scene: Scene, material: int) -> float:
    """Upper bound of the mean number of events of a walk, over channels.

    Walks from diffuse light have the mean path n² 4V/S in a body that does not absorb, whatever it scatters (Blanco and
    Fournier 2003, "An invariance property of diffusive random walks"); absorption ends them after σ_t / σ_a collisions.
    """
    medium = scene.materials[material].subsurface
    assert medium is not None
    area = scene.mesh.areas[scene.mesh.material == material].sum()
    path = medium.ior**2 * 4.0 * enclosed_volume(scene, material) / area
    alive = np.divide(1.0, 1.0 - medium.albedo, out=np.full(3, np.inf), where=medium.albedo < 1)
    return float(np.mean(1.0 + np.minimum(path * medium.extinction, alive)))


class WalkRates(NamedTuple):
    """`queries` and `seconds` on all workers together are those of walks in all `channels` that have their own, per ray of a
    point anywhere on the scene's surface, of which a `share` is translucent."""

    queries: float
    seconds: float
    channels: int
    share: float


def measured_rates(scene: Scene, workers: int | None) -> WalkRates:
    """Some walks from all over the bodies, timed here and now, for predictions."""
    area, rng = scene.mesh.areas, np.random.default_rng(0)
    inside, translucent = bodies(scene, workers), np.flatnonzero(scene.translucent_at(np.arange(len(area))))
    share, channels = float(area[translucent].sum() / area.sum()), _channels(inside)
    sampler = HemisphereSampler.create(_PILOT_WALKS, 0)
    face = rng.choice(translucent, _PILOT_POINTS, p=area[translucent] / area[translucent].sum())
    owner, normal = scene.mesh.material[face], scene.mesh.normals[face]
    place = np.einsum("nc,ncd->nd", rng.dirichlet([1.0, 1.0, 1.0], len(face)), scene.mesh.triangles[face])
    towards = np.asarray(sampler.directions(np.arange(len(face)), normal), float)
    keys = walk_keys(np.arange(len(face)), _PILOT_WALKS, 0)
    started = time.perf_counter()
    for material, body in inside.items():
        here = np.flatnonzero(owner == material)
        position, outward = (np.repeat(part[here], _PILOT_WALKS, axis=0) for part in (place, normal))
        follow_all(body, channels, position, outward, towards[here].reshape(-1, 3), keys[here].ravel())
    seconds, queries = time.perf_counter() - started, sum(body.tracer.nearest for body in inside.values())
    each = share / keys.size
    return WalkRates(each * queries, each * seconds, channels, share)


def _channels(inside: Mapping[int, Body]) -> int:
    """How many channels have walks of their own."""
    return 1 if all(body.medium.grey for body in inside.values()) else 3


class WalkTracer:
    """Traces the walks of a scene and resolves where they end to gather samples."""

    def __init__(
        self,
        scene: Scene,
        lightmap: Lightmap,
        samples: SurfacePoints,
        sampler: HemisphereSampler,
        workers: int | None = None,
    ) -> None:
        self.scene, self.sampler = scene, sampler
        self.bodies = bodies(scene, workers)
        # A texel that another body stands on is dark, and stays so: no light enters where it lies.
        self.resolver = HitResolver.create(scene.mesh, lightmap, samples)
        self.media = _channels(self.bodies)

    def ends(
        self, points: SurfacePoints, index: Int[np.ndarray, " p"]
    ) -> tuple[Int[np.ndarray, "p D W"], Int[np.ndarray, "bodies D F"]]:
        """Samples where walks from translucent points left their body, S for none, and the counts of fates.

        `index` are the numbers of the points among all of their kind, which choose random numbers.
        """
        walks = self.sampler.local.shape[1]
        table = np.full((len(points), self.media, walks), self.resolver.samples, self.resolver.sample.dtype)
        fates = np.zeros((len(self.bodies), self.media, len(Fate)), np.int64)
        owner = self.scene.mesh.material[points.face]
        for number, (material, body) in enumerate(self.bodies.items()):
            here = np.flatnonzero(owner == material)
            if not here.size:
                continue
            normal = self.scene.mesh.normals[points.face[here]]
            direction = self.sampler.directions(index[here], normal).reshape(-1, 3).astype(float)
            keys = walk_keys(index[here], walks, self.sampler.seed).ravel()
            starts = (np.repeat(points.position[here], walks, axis=0), np.repeat(normal, walks, axis=0))
            for channel, found in enumerate(follow_all(body, self.media, *starts, direction, keys)):
                table[here, channel] = self._resolved(body, found, keys).reshape(-1, walks)
                fates[number, channel] += np.bincount(found.fate, minlength=len(Fate))
        return table, fates

    def _resolved(self, body: Body, found: Ends, keys: np.ndarray) -> Int[np.ndarray, " n"]:
        face = body.faces[found.face].astype(np.int32)
        place = hashed(keys + _PLACE)
        jitter = tuple(
            ((part & np.uint64(0xFFFFFF)).astype(np.float32) / np.float32(1 << 24) - np.float32(0.5))[:, None]
            for part in (place, place >> np.uint64(32))
        )
        hits = {"primID": face, "u": found.u, "v": found.v}
        towards = (-self.scene.mesh.normals[face]).astype(np.float32)
        samples = self.resolver(hits, towards, jitter, np.arange(len(face)))  # pyright: ignore[reportArgumentType]
        return np.where(found.fate == Fate.ESCAPED, samples, np.asarray(self.resolver.samples, samples.dtype))


def write_walks(
    group: zarr.Group, journal: Journal, first: int, tracer: WalkTracer, tables: dict[str, SurfacePoints]
) -> None:
    """Trace and store the walks of all `tables` of points, chunk by chunk; journal entries are numbered from `first`."""
    scene, store = tracer.scene, group.require_group("walks")
    shape = (tracer.media, tracer.sampler.local.shape[1])
    chunks = []
    for name, points in tables.items():
        rows, child = np.flatnonzero(scene.translucent_at(points.face)), store.require_group(name)
        write_array(child, "rows", rows.astype(np.int32))
        write_array(child, "material", scene.mesh.material[points.face[rows]].astype(np.int32))
        size = (min(_POINTS, max(len(rows), 1)), *shape)
        create_array(child, "ends", (len(rows), *shape), size, tracer.resolver.sample.dtype)
        chunks += [(name, rows[at : at + _POINTS], slice(at, at + _POINTS)) for at in range(0, len(rows), _POINTS)]
    missing = [(first + i, chunk) for i, chunk in enumerate(chunks) if first + i not in journal.done]
    for number, (name, rows, part) in track(missing, f"walk in {scene.name}"):
        ends, fates = tracer.ends(tables[name][rows], rows)
        store[f"{name}/ends"][part] = ends  # pyright: ignore[reportIndexIssue]
        journal.add(number, fates=fates.tolist())
    found = np.array([journal.done[first + i]["fates"] for i in range(len(chunks))], np.int64)
    found = found.reshape(len(chunks), len(tracer.bodies), tracer.media, len(Fate))
    from_receivers = np.array([name == "receivers" for name, _, _ in chunks], bool)
    write_array(store, "colour", _colours(tracer, tables["receivers"], found[from_receivers].sum(axis=0)))
    store.attrs["fates"] = json.dumps(
        {
            scene.materials[material].name: {fate.name.lower(): counts[:, fate].tolist() for fate in Fate}
            for material, counts in zip(tracer.bodies, found.sum(axis=0), strict=True)
        }
    )
    left = found[..., [Fate.ALIVE, Fate.LOST]].sum() / max(found.sum(), 1)
    if left > 0:
        say(f"walks in {scene.name}: {left:.1e} of them neither left nor were absorbed after {LONGEST} events")


def _colours(
    tracer: WalkTracer, points: SurfacePoints, fates: Int[np.ndarray, "bodies D F"]
) -> Float[np.ndarray, "materials 3"]:
    """Share that each body returns of light that is the same everywhere; 1 where a material has none, or returns nothing."""
    colour = np.ones((len(tracer.scene.materials), 3), np.float32)
    owner = tracer.scene.mesh.material[points.face]
    for material, counts in zip(tracer.bodies, fates, strict=True):
        albedo = points.albedo[owner == material]
        share = counts[:, Fate.ESCAPED] / np.maximum(counts.sum(axis=1), 1) + albedo.sum(axis=0) / max(len(albedo), 1)
        colour[material] = np.where(share > 0, share, 1.0)
    return colour
