"""Random walks through the bodies of translucent materials, from outside of one point to where light came in.

A walk starts outside, at a point x_o with a cosine-weighted direction, enters by Fresnel's law and is followed backwards until
it leaves the body at x_i or is absorbed. Diffuse light that enters at x_i leaves at x_o with the same density as the other way
round, by reciprocity, so the share of walks that end around x_i is K(x_o, x_i): the exitance at x_o per irradiance at x_i.

Walks are analogue: a collision absorbs or scatters, a boundary reflects or lets through, nothing is weighted, and the counts of
fates add up exactly. (Wang, Jacques and Zheng 1995, "MCML – Monte Carlo modeling of light transport in multi-layered tissues",
for the events.) What is made of walks is in `effects/subsurface.py`.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from data_gen.tracer import Tracer
from prt_bench.hemisphere import hashed, tangent_frames
from prt_bench.medium import Subsurface, fresnel
from prt_bench.scene import Mesh, Scene

LONGEST = 1 << 16
"""Events after which a walk that is still alive is given up, and counted."""
_AT_ONCE = 1 << 15  # walks followed together by one worker
_BLOCK = 1 << 18  # walks that one worker follows before it takes others
_GAP = 2.0**-22  # how far below the surface a walk goes on, relative to the body's extent: some units of float32
_STEP, _ENTRY = np.uint64(8), np.uint64(5)


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
    """The bodies of a scene by material index."""
    found = {}
    for index in np.unique(scene.mesh.material):
        medium = scene.materials[index].subsurface
        if medium is None:
            continue
        faces = np.flatnonzero(scene.mesh.material == index)
        # About the body's own middle float32 is finest.
        centre = 0.5 * (scene.mesh.triangles[faces].min((0, 1)) + scene.mesh.triangles[faces].max((0, 1)))
        mesh = Mesh(scene.mesh.vertices - centre, scene.mesh.faces[faces], scene.mesh.material[faces])
        alone = replace(scene, mesh=mesh)
        found[int(index)] = Body(medium, faces, centre, mesh.normals, Tracer(alone, workers), alone.extent)
    return found


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
    return _followed(body, (channel,), position, normal, direction, key)[0]


def follow_all(
    body: Body,
    channels: int,
    position: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    key: Int[np.ndarray, " n"],
) -> list[Ends]:
    """What `follow` gives for each of the first channels. Those of one mean free path share their walks, which costs as
    much as the least absorbed of them alone."""
    extinction = body.medium.extinction[:channels]
    found: dict[int, Ends] = {}
    for shared in np.unique(extinction):
        group = tuple(map(int, np.flatnonzero(extinction == shared)))
        found |= dict(zip(group, _followed(body, group, position, normal, direction, key), strict=True))
    return [found[channel] for channel in range(channels)]


def _followed(
    body: Body,
    channels: tuple[int, ...],
    position: np.ndarray,
    normal: np.ndarray,
    direction: np.ndarray,
    key: np.ndarray,
) -> tuple[Ends, ...]:
    """Ends of walks by channel, all of which have one extinction."""
    ends = tuple(_nowhere(len(key)) for _ in channels)
    walks = _Walks(body, channels, ends, position, normal, direction, key)
    size = min(max(-(-len(key) // body.tracer.workers), 1), _BLOCK)
    blocks = [slice(at, at + size) for at in range(0, len(key), size)]
    with body.tracer.pool() as executor:
        list(executor.map(walks.run, blocks))
    return ends


def _nowhere(count: int) -> Ends:
    """Ends to be filled in."""
    places = (np.zeros(count, dtype) for dtype in (np.int32, np.float32, np.float32, np.int32))
    return Ends(np.full(count, Fate.LOST, np.int8), *places)  # pyright: ignore[reportCallIssue]


@dataclass(frozen=True)
class _Walks:
    """Walks that some channels of a body share; `run` follows a block of them."""

    body: Body
    channels: tuple[int, ...]
    ends: tuple[Ends, ...]
    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    key: Int[np.ndarray, " n"]

    @cached_property
    def _medium(self) -> tuple[float, list[float]]:
        """The extinction and, by channel, the albedo."""
        medium = self.body.medium
        return float(medium.extinction[self.channels[0]]), [float(medium.albedo[channel]) for channel in self.channels]

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
        for ends in self.ends:
            ends.fate[walk[reflected]] = Fate.REFLECTED
        walk, n, away, cosine = walk[~reflected], n[~reflected], away[~reflected], cosine[~reflected]
        # Snell's law, for light that arrives along −away.
        through = np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)
        inside = (cosine / ior - through)[:, None] * n - away / ior
        place = self.position[walk] - self.body.centre - self.body.gap * n
        return _Active(walk, place, normalised(inside), np.ones(len(walk), np.uint64), np.full(len(walk), -1.0))

    def _advance(self, active: "_Active") -> "_Active":
        """One event of each walk: a collision in the medium, or the boundary."""
        body, (extinction, albedo) = self.body, self._medium
        key = self.key[active.walk] + active.count * _STEP
        step = free_paths(uniform(key, np.uint64(0)), extinction)
        reach = np.minimum(step, 4.0 * body.extent).astype(np.float32)
        found = body.tracer.trace(active.place.astype(np.float32), active.direction.astype(np.float32), reach)
        face = found["primID"]
        met = face >= 0
        lost = ~met & (step >= 4.0 * body.extent)
        self._end(active, np.flatnonzero(lost), Fate.LOST)

        away = ~met & ~lost
        place = active.place + np.where(met, found["tfar"], step)[:, None] * active.direction
        direction, choice = active.direction.copy(), uniform(key, np.uint64(1))
        toll = np.where(away, np.maximum(active.toll, choice), active.toll)
        for ends, share in zip(self.ends, albedo, strict=True):
            absorbed = np.flatnonzero((active.toll < share) & (toll >= share))
            ends.fate[active.walk[absorbed]], ends.events[active.walk[absorbed]] = Fate.ABSORBED, active.count[absorbed]
        active = active._replace(toll=toll)
        going = ~lost & (toll < max(albedo))
        some = np.flatnonzero(away & going)
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
        for ends, here in self._end(active, leaving, Fate.ESCAPED):
            for name, places in (("primID", ends.face), ("u", ends.u), ("v", ends.v)):
                places[active.walk[here]] = found[name][here]
        going[leaving] = False
        direction[back] -= 2.0 * cosine[~out, None] * normal[~out]
        place[back] -= body.gap * normal[~out]

        old = going & (active.count >= LONGEST)
        self._end(active, np.flatnonzero(old), Fate.ALIVE)
        going &= ~old
        moved = active._replace(place=place, direction=direction, count=active.count + np.uint64(1))
        return _Active(*(column[going] for column in moved))

    def _end(self, active: "_Active", here: Int[np.ndarray, " m"], fate: Fate) -> list[tuple[Ends, np.ndarray]]:
        """End walks in all channels that did not absorb them: the ends of each, and which walks those are."""
        ended = []
        for ends, share in zip(self.ends, self._medium[1], strict=True):
            alive = here[active.toll[here] < share]
            ends.fate[active.walk[alive]], ends.events[active.walk[alive]] = fate, active.count[alive]
            ended.append((ends, alive))
        return ended


class _Active(NamedTuple):
    """Walks on their way: which, where (about the body's middle), in which unit direction, after how many events, and the
    greatest number that chose between absorption and scattering so far: channels of a greater albedo are alive."""

    walk: Int[np.ndarray, " n"]
    place: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    count: Int[np.ndarray, " n"]
    toll: Float[np.ndarray, " n"]

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


def free_paths(u: Float[np.ndarray, " n"], extinction: float) -> Float[np.ndarray, " n"]:
    """Distances to the next collision in metres from uniform numbers in [0, 1): finite, and 0 at u = 0."""
    return -np.log1p(-u) / extinction


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
