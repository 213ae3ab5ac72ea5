"""Subsurface scattering: random walks through the bodies of translucent materials, from each point to where light came in.

A walk starts outside, at a point x_o with a cosine-weighted direction, enters by Fresnel's law and is followed backwards until
it leaves the body at x_i or is absorbed. Diffuse light that enters at x_i leaves at x_o with the same density as the other way
round, by reciprocity, so the share of walks that end around x_i is K(x_o, x_i): the exitance at x_o per irradiance at x_i.

Walks are analogue: a collision absorbs or scatters, a boundary reflects or lets through, nothing is weighted. So a walk is one
sample index in a hit table, each channel has walks of its own (where they differ), and the counts of fates add up exactly.
(Wang, Jacques and Zheng 1995, "MCML – Monte Carlo modeling of light transport in multi-layered tissues", for the events.)
"""

import json
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
import zarr
from jaxtyping import Float, Int

from data_gen.geometry import Part, is_closed
from data_gen.journal import Journal, create_array
from data_gen.resolve import HitResolver
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.hemisphere import HemisphereSampler, hashed, tangent_frames
from prt_bench.medium import Subsurface, fresnel
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.progress import say, track
from prt_bench.scene import Mesh, Scene
from prt_bench.store import write_array

LONGEST = 1 << 16
"""Events after which a walk that is still alive is given up, and counted."""
_POINTS = 1 << 11  # translucent points whose walks are traced and stored together
_AT_ONCE = 1 << 15  # walks followed together by one worker
_BLOCK = 1 << 18  # walks that one worker follows before it takes others
_GAP = 2.0**-22  # how far below the surface a walk goes on, relative to the body's extent: some units of float32
_STEP, _ENTRY, _PLACE = np.uint64(8), np.uint64(5), np.uint64(6)


class Fate(IntEnum):
    """How a walk ended."""

    ESCAPED = 0
    ABSORBED = 1
    REFLECTED = 2  # at the boundary, from outside: it never entered
    ALIVE = 3  # after `LONGEST` events
    LOST = 4  # by rounding, through an edge between two triangles


class Ends(NamedTuple):
    """n ends of walks: fate, where they left the body (face among the body's, barycentric coordinates), and after how many
    events: collisions and encounters with the boundary from within."""

    fate: Int[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    events: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class Body:
    """The closed surfaces of one translucent material; walks see nothing else."""

    medium: Subsurface
    faces: Int[np.ndarray, " f"]
    centre: Float[np.ndarray, "3"]
    normals: Float[np.ndarray, "f 3"]
    tracer: Tracer
    extent: float

    @property
    def gap(self) -> float:
        """How far below the surface walks go on."""
        return _GAP * self.extent


def bodies(scene: Scene, workers: int | None = None) -> dict[int, Body]:
    """The bodies of a scene by material index. Raises `SceneError` for a medium in an open surface."""
    found = {}
    for index in np.unique(scene.mesh.material):
        medium = scene.materials[index].subsurface
        if medium is None:
            continue
        faces = np.flatnonzero(scene.mesh.material == index)
        check_closed(scene, int(index))
        # About the body's own middle float32 is finest.
        centre = 0.5 * (scene.mesh.triangles[faces].min((0, 1)) + scene.mesh.triangles[faces].max((0, 1)))
        mesh = Mesh(scene.mesh.vertices - centre, scene.mesh.faces[faces], scene.mesh.material[faces])
        alone = replace(scene, mesh=mesh)
        found[int(index)] = Body(medium, faces, centre, mesh.normals, Tracer(alone, workers), alone.extent)
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


def follow(
    body: Body,
    channel: int,
    position: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    key: Int[np.ndarray, " n"],
) -> Ends:
    """Follow walks that look from outside along unit `direction`s, up from the surface at `position`, backwards into the body.

    `key` chooses each walk's random numbers, so that a walk does not depend on the others.
    """
    ends = Ends(
        np.full(len(key), Fate.LOST, np.int8),
        np.zeros(len(key), np.int32),
        *(np.zeros(len(key), np.float32) for _ in "uv"),
        np.zeros(len(key), np.int32),
    )
    walks = _Walks(body, channel, ends, position, normal, direction, key)
    blocks = [slice(at, at + _BLOCK) for at in range(0, len(key), _BLOCK)]
    with body.tracer.pool() as executor:
        list(executor.map(walks.run, blocks))
    return ends


@dataclass(frozen=True)
class _Walks:
    """Walks in one channel of a body; `run` follows a block of them."""

    body: Body
    channel: int
    ends: Ends
    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    key: Int[np.ndarray, " n"]

    @cached_property
    def _medium(self) -> tuple[float, float]:
        return float(self.body.medium.extinction[self.channel]), float(self.body.medium.albedo[self.channel])

    def run(self, block: slice) -> None:
        """Follow the walks of a block, new ones taking the place of those that ended."""
        start, last = block.start, min(block.stop, len(self.key))
        active = self._enter(np.arange(start, start))
        while start < last or len(active.walk):
            if len(active.walk) < _AT_ONCE // 2 and start < last:
                fresh = np.arange(start, min(start + _AT_ONCE - len(active.walk), last))
                start = int(fresh[-1]) + 1
                active = active.with_more(self._enter(fresh))
            active = self._advance(active)

    def _enter(self, walk: Int[np.ndarray, " n"]) -> "_Active":
        """Refract walks into the body; those that the boundary reflects end here."""
        ior, n, away = self.body.medium.ior, self.normal[walk], self.direction[walk]
        cosine = np.clip(np.einsum("nd,nd->n", away, n), 0.0, 1.0)
        reflected = uniform(self.key[walk], _ENTRY) < fresnel(cosine, ior)
        self.ends.fate[walk[reflected]] = Fate.REFLECTED
        walk, n, away, cosine = walk[~reflected], n[~reflected], away[~reflected], cosine[~reflected]
        # Snell's law, for light that arrives along −away.
        through = np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)
        inside = (cosine / ior - through)[:, None] * n - away / ior
        place = self.position[walk] - self.body.centre - self.body.gap * n
        return _Active(walk, place, normalised(inside), np.ones(len(walk), np.uint64))

    def _advance(self, active: "_Active") -> "_Active":
        """One event of each walk: a collision in the medium, or the boundary."""
        body, (extinction, albedo) = self.body, self._medium
        key = self.key[active.walk] + active.count * _STEP
        # u < 1, so the logarithm is finite; u = 0 is a step of no length.
        step = -np.log1p(-uniform(key, np.uint64(0))) / extinction
        reach = np.minimum(step, 4.0 * body.extent).astype(np.float32)
        found = body.tracer.trace(active.place.astype(np.float32), active.direction.astype(np.float32), reach)
        face = found["primID"]
        met = face >= 0
        lost = ~met & (step >= 4.0 * body.extent)
        self.ends.fate[active.walk[lost]] = Fate.LOST

        away = ~met & ~lost
        place = active.place + np.where(met, found["tfar"], step)[:, None] * active.direction
        direction, going = active.direction.copy(), ~lost
        choice = uniform(key, np.uint64(1))
        absorbed = away & (choice >= albedo)
        self.ends.fate[active.walk[absorbed]] = Fate.ABSORBED
        going &= ~absorbed
        some = np.flatnonzero(away & ~absorbed)
        direction[some] = scattered(
            active.direction[some],
            body.medium.anisotropy,
            uniform(key[some], np.uint64(2)),
            uniform(key[some], np.uint64(3)),
        )

        some = np.flatnonzero(met)
        normal = body.normals[face[some]]
        cosine = np.einsum("nd,nd->n", direction[some], normal)
        outward = cosine > 0  # else the walk only passes, by rounding, the surface that it comes from
        place[some[~outward]] += body.gap * direction[some[~outward]]
        some, normal, cosine = some[outward], normal[outward], cosine[outward]
        out = choice[some] >= fresnel(np.minimum(cosine, 1.0), 1.0 / body.medium.ior)
        leaving, back = some[out], some[~out]
        walk = active.walk[leaving]
        self.ends.fate[walk] = Fate.ESCAPED
        self.ends.face[walk], self.ends.u[walk], self.ends.v[walk] = (
            found[name][leaving] for name in ("primID", "u", "v")
        )
        going[leaving] = False
        direction[back] -= 2.0 * cosine[~out, None] * normal[~out]
        place[back] -= body.gap * normal[~out]

        old = going & (active.count >= LONGEST)
        self.ends.fate[active.walk[old]] = Fate.ALIVE
        going &= ~old
        self.ends.events[active.walk[~going]] = active.count[~going]
        return _Active(active.walk[going], place[going], direction[going], active.count[going] + np.uint64(1))


class _Active(NamedTuple):
    """Walks on their way: which, where (about the body's middle), in which unit direction, and after how many events."""

    walk: Int[np.ndarray, " n"]
    place: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    count: Int[np.ndarray, " n"]

    def with_more(self, other: "_Active") -> "_Active":
        return _Active(*(np.concatenate(both) for both in zip(self, other, strict=True)))


def scattered(
    direction: Float[np.ndarray, "n 3"],
    anisotropy: float,
    first: Float[np.ndarray, " n"],
    second: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Unit directions after scattering by the Henyey–Greenstein phase function, from two uniform numbers each."""
    g = anisotropy
    if abs(g) < 1e-3:  # the inverse below divides by g; this is its expansion to first order
        cosine = 2.0 * first - 1.0 + 6.0 * g * first * (1.0 - first)
    else:
        cosine = (1.0 + g * g - ((1.0 - g * g) / (1.0 + g - 2.0 * g * first)) ** 2) / (2.0 * g)
    cosine = np.clip(cosine, -1.0, 1.0)
    frames = tangent_frames(direction, 2.0 * np.pi * second)
    return normalised(np.sqrt(1.0 - cosine**2)[:, None] * frames[:, 0] + cosine[:, None] * direction)


def uniform(key: Int[np.ndarray, " n"], which: np.uint64) -> Float[np.ndarray, " n"]:
    """The number of each key in [0, 1) that `which` names; of 53 bits, so never 1."""
    return (hashed(key + which) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def walk_keys(points: Int[np.ndarray, " p"], walks: int, seed: int) -> Int[np.ndarray, "p W"]:
    """A key for each walk of each point, far from those of all others."""
    point = hashed(points.astype(np.uint64) + (np.uint64(seed) << np.uint64(40)))
    return hashed(point[:, None] ^ hashed(np.arange(walks, dtype=np.uint64))[None])


def normalised(vector: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vectors along the given ones."""
    return vector / np.sqrt(np.einsum("nd,nd->n", vector, vector))[:, None]


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
        self.media = 1 if all(body.medium.grey for body in self.bodies.values()) else 3

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
            for channel in range(self.media):
                found = follow(body, channel, *starts, direction, keys)
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
    from_receivers = np.array([name == "receivers" for name, _, _ in chunks])
    write_array(store, "colour", _colours(tracer, tables["receivers"], found[from_receivers].sum(axis=0)))
    store.attrs["fates"] = json.dumps(
        {
            scene.materials[material].name: {fate.name.lower(): counts[:, fate].tolist() for fate in Fate}
            for material, counts in zip(tracer.bodies, found.sum(axis=0), strict=True)
        }
    )
    left = found[..., [Fate.ALIVE, Fate.LOST]].sum() / found.sum()
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
