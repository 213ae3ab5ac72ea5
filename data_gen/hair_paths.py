"""Paths of light among strands of hair, from the strands' texels backwards to every place where light may have come from.

A path begins with light that leaves a texel, in any direction alike, and is followed backwards from fibre to fibre by the
scattering function (`prt_bench.hair`), until it is absorbed, meets a surface or leaves the scene. Paths are analogue: nothing
is weighted. All channels share a path, which is that of the least absorbed one; the others leave it where they would have been
absorbed. What is made of paths is in `effects/hair.py`.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from data_gen.medium_walk import normalised, uniform
from data_gen.resolve import HitResolver
from data_gen.strand_atlas import texel_edges
from data_gen.tracer import Tracer
from prt_bench.hair import Hair, Inclination, crossing, draw
from prt_bench.hemisphere import hashed, tangent_frames
from prt_bench.scene import Mesh, Scene
from prt_bench.strands import TEXELS, Strands

LONGEST = 1 << 14
"""Rays after which a path that is still alive is given up, and counted."""
BLOCK = 1 << 15
"""Paths that one worker follows together."""
_STEP = np.uint64(16)
_PASSES = 16  # backs of tubes that a ray may pass on its way out of a bent strand
_PLACE = np.uint64(11)  # chooses the jitter of a resolved place


class Fate(IntEnum):
    """How a path ended, for one channel."""

    ESCAPED = 0
    ABSORBED = 1
    SURFACE = 2
    ALIVE = 3  # after `LONGEST` rays
    LOST = 4  # by rounding, inside a tube


class Visits(NamedTuple):
    """Places where light that goes along paths may have come from: the `path`, the gather `sample` there and, for each of the D
    channels, whether light would have `passed` from there. Surfaces are visited whatever they reflect; `surface` tells them."""

    path: Int[np.ndarray, " v"]
    sample: Int[np.ndarray, " v"]
    passed: Bool[np.ndarray, "v D"]
    surface: Bool[np.ndarray, " v"]


class Followed(NamedTuple):
    """Visits of some paths, step by step in each, their `fate` [n, D], and whether the first ray of each met nothing: 1, 0, or
    −1 where there was no ray."""

    visits: Visits
    fate: Int[np.ndarray, "n D"]
    open: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class StrandPaths:
    """Follows paths in one scene; `channels` is 1 where all that paths meet is grey, else 3."""

    scene: Scene
    strands: Strands
    tracer: Tracer
    resolver: HitResolver
    channels: int

    def follow(self, texel: Int[np.ndarray, " n"], key: Int[np.ndarray, " n"]) -> Followed:
        """Paths from strand texels (strand · TEXELS + place), whose random numbers `key` chooses, one by one."""
        blocks = [slice(at, at + BLOCK) for at in range(0, len(key), BLOCK)]
        with self.tracer.pool() as executor:
            parts = list(executor.map(lambda block: self._run(texel[block], key[block]), blocks))
        visits = [
            part.visits._replace(path=part.visits.path + block.start) for part, block in zip(parts, blocks, strict=True)
        ]
        return Followed(
            Visits(*(np.concatenate(column) for column in zip(*visits, strict=True))),
            np.concatenate([part.fate for part in parts]),
            np.concatenate([part.open for part in parts]),
        )

    def openness(self, texel: Int[np.ndarray, " n"], rays: int, key: int) -> Float[np.ndarray, " n"]:
        """Direct irradiance on strand texels from radiance 1/π that comes in from outside of the hair: how open it is there."""
        number = texel[:, None].astype(np.uint64) * np.uint64(rays) + np.arange(rays, dtype=np.uint64)
        keys = hashed(number.ravel() + np.uint64(key) * np.uint64(1 << 40))
        seen = np.empty(len(keys), bool)

        def look(block: slice) -> None:
            here = np.arange(len(keys))[block] // rays
            strand, _, position, tangent = self._place(texel[here], keys[block], 0.5)
            direction = _from_everywhere(tangent, keys[block])
            origin = self._outside(strand, position, tangent, direction).astype(np.float32)
            seen[block] = ~self._alone.occluded(origin, direction * self.tracer.reach)

        with self.tracer.pool() as executor:
            list(executor.map(look, [slice(at, at + BLOCK) for at in range(0, len(keys), BLOCK)]))
        if self._alone is not self.tracer:
            self.tracer.shadow += len(keys)
        return seen.reshape(-1, rays).mean(axis=1)

    @cached_property
    def _alone(self) -> Tracer:
        """Rays against the strands and nothing else."""
        mesh, surfaces = self.scene.mesh, self.scene.surfaces
        if not surfaces:
            return self.tracer
        alone = Mesh(mesh.vertices, mesh.faces[surfaces:], mesh.material[surfaces:])
        return Tracer(replace(self.scene, mesh=alone, strands=None), self.tracer.workers)

    def _place(
        self, texel: np.ndarray, key: np.ndarray, along: float | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Strand, segment, point and tangent somewhere in texels, or at the share `along` of them."""
        strand, place = np.divmod(texel, TEXELS)
        low, high = texel_edges()[place], texel_edges()[place + 1]
        position, segment = self.strands.at(
            strand, low + (high - low) * (uniform(key, np.uint64(12)) if along is None else along)
        )
        return strand, segment, position, self.strands.tangents[segment]

    def _run(self, texel: np.ndarray, key: np.ndarray) -> Followed:
        count = len(key)
        fate = np.full((count, self.channels), Fate.ABSORBED, np.int8)
        first = np.full(count, -1, np.int8)
        visits: list[Visits] = []
        strand, _, position, tangent = self._place(texel, key)
        towards = _from_everywhere(tangent, key)
        walk = np.arange(count)
        passed = np.ones((count, self.channels), bool)
        passed, direction = self._scattered(strand, tangent, towards, passed, key)
        going = passed.any(axis=1)
        origin = self._outside(strand, position, tangent, direction)
        state = tuple(part[going] for part in (walk, origin, direction, passed))
        backs = np.zeros(going.sum(), np.int8)
        for step in range(1, LONGEST):
            if not len(state[0]):
                break
            state, backs = self._advance(state, backs, key + np.uint64(step) * _STEP, fate, first, visits)
        fate[state[0]] = np.where(state[3], Fate.ALIVE, fate[state[0]])
        if not visits:
            empty = np.zeros(0, np.int64)
            visits.append(Visits(empty, empty, np.zeros((0, self.channels), bool), np.zeros(0, bool)))
        return Followed(Visits(*(np.concatenate(column) for column in zip(*visits, strict=True))), fate, first)

    def _advance(
        self,
        state: tuple,
        backs: np.ndarray,
        keys: np.ndarray,
        fate: np.ndarray,
        first: np.ndarray,
        visits: list[Visits],
    ) -> tuple[tuple, np.ndarray]:
        """One ray of each path, and what it meets."""
        walk, origin, direction, passed = state
        found = self.tracer.trace(origin.astype(np.float32), direction.astype(np.float32))
        face = found["primID"]
        met, surfaces = face >= 0, self.scene.surfaces
        back = met & (np.einsum("nd,nd->n", found["Ng"], direction) > 0)
        on_hair = met & (face >= surfaces)
        fresh = first[walk] < 0
        first[walk[fresh & ~(back & on_hair)]] = 0
        out = ~met
        first[walk[fresh & out]] = 1
        fate[walk[out]] = np.where(passed[out], Fate.ESCAPED, fate[walk[out]])

        key = keys[walk]
        ends = met & ~on_hair
        fate[walk[ends]] = np.where(passed[ends], Fate.SURFACE, fate[walk[ends]])
        sample = self._samples(found, direction, key)
        some = np.flatnonzero(ends & (sample < self.resolver.samples))
        if some.size:
            visits.append(Visits(walk[some], sample[some], passed[some], np.ones(some.size, bool)))

        through = on_hair & back
        lost = through & (backs >= _PASSES)
        fate[walk[lost]] = np.where(passed[lost], Fate.LOST, fate[walk[lost]])
        through &= ~lost
        beyond = origin + (found["tfar"][:, None] * (1.0 + 2.0**-20) + self.tracer.offset * 2.0**-6) * direction

        some = np.flatnonzero(on_hair & ~back)
        strand, position, tangent = self._fibre(face[some] - surfaces, found["u"][some], found["v"][some])
        alive, turned = self._scattered(strand, tangent, -direction[some], passed[some], key[some])
        going = alive.any(axis=1)
        here = some[going]
        if here.size:
            visits.append(Visits(walk[here], sample[here], alive[going], np.zeros(here.size, bool)))
        onward = self._outside(strand[going], position[going], tangent[going], turned[going])
        kept = np.flatnonzero(through)
        return (
            (
                np.concatenate([walk[kept], walk[here]]),
                np.concatenate([beyond[kept], onward]),
                np.concatenate([direction[kept], turned[going]]),
                np.concatenate([passed[kept], alive[going]]),
            ),
            np.concatenate([backs[kept] + np.int8(1), np.zeros(here.size, np.int8)]),
        )

    def _scattered(
        self, strand: np.ndarray, tangent: np.ndarray, towards: np.ndarray, passed: np.ndarray, key: np.ndarray
    ) -> tuple[Bool[np.ndarray, "n D"], Float[np.ndarray, "n 3"]]:
        """Which channels pass a fibre, for light that leaves it along `towards`, and where that light came from."""
        material = self.strands.material[strand]
        alive, direction = passed.copy(), np.zeros_like(towards)
        for index in np.unique(material):
            hair = self.scene.materials[index].hair
            assert hair is not None
            here = np.flatnonzero(material == index)
            alive[here], direction[here] = _through_fibre(hair, tangent[here], towards[here], passed[here], key[here])
        return alive, direction

    def _fibre(
        self, face: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Strand, point on the axis and tangent where rays met tubes."""
        node = self.strands.corners[0][face]
        share = np.stack([1.0 - u - v, u, v], axis=1).astype(float)
        strand = self.strands.owner[node[:, 0]]
        return (
            strand,
            np.einsum("nc,ncd->nd", share, self.strands.nodes[node]),
            self.strands.tangents[node[:, 0] - strand],
        )

    def _outside(
        self, strand: np.ndarray, position: np.ndarray, tangent: np.ndarray, direction: np.ndarray
    ) -> Float[np.ndarray, "n 3"]:
        """Just outside of a strand's tube, on the side that a ray goes to."""
        across = direction - np.einsum("nd,nd->n", direction, tangent)[:, None] * tangent
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        return position + self.strands.clearance[strand][:, None] * across

    def _samples(self, found: dict[str, np.ndarray], direction: np.ndarray, key: np.ndarray) -> Int[np.ndarray, " n"]:
        place = hashed(key + _PLACE)
        jitter = tuple(
            ((part & np.uint64(0xFFFFFF)).astype(np.float32) / np.float32(1 << 24) - np.float32(0.5))[:, None]
            for part in (place, place >> np.uint64(32))
        )
        # A fixed size, so that the kernel is compiled once for all steps.
        room = 1 << max(int(len(key) - 1).bit_length(), 10)
        pad = room - len(key)
        hits = {name: np.pad(found[name], (0, pad)) for name in ("primID", "u", "v")}
        towards = np.pad(direction.astype(np.float32), ((0, pad), (0, 0)))
        offsets = tuple(np.pad(part, ((0, pad), (0, 0))) for part in jitter)
        resolved = self.resolver(hits, towards, offsets, np.arange(room))  # pyright: ignore[reportArgumentType]
        return resolved[: len(key)]


def _from_everywhere(tangent: Float[np.ndarray, "n 3"], key: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Unit directions as likely as light that falls on, or leaves, a fibre when there is the same from everywhere."""
    # The component along the tangent is that of a point in the unit disc.
    sine = np.sqrt(uniform(key, np.uint64(13))) * np.cos(2.0 * np.pi * uniform(key, np.uint64(14)))
    frames = tangent_frames(tangent, 2.0 * np.pi * uniform(key, np.uint64(15)))
    return np.sqrt(1.0 - sine**2)[:, None] * frames[:, 0] + sine[:, None] * tangent


def _through_fibre(
    hair: Hair, tangent: np.ndarray, towards: np.ndarray, passed: np.ndarray, key: np.ndarray
) -> tuple[Bool[np.ndarray, "n D"], Float[np.ndarray, "n 3"]]:
    """One event at fibres of one kind."""
    channels = passed.shape[1]
    leader = int(np.argmin(hair.absorption[:channels]))
    frames = tangent_frames(tangent, np.zeros(len(key)))
    out = Inclination.of(np.einsum("nd,nd->n", towards, tangent))
    found = crossing(hair, out, 2.0 * uniform(key, np.uint64(0)) - 1.0, slice(0, channels))
    weights = found.weights
    total = np.cumsum(weights[:, :, leader], axis=1)
    choice = uniform(key, np.uint64(1))
    lobe = np.sum(choice[:, None] >= total, axis=1)
    absorbed = (lobe == total.shape[1]) & (total[:, -1] < 1.0 - 1e-9)
    lobe = np.minimum(lobe, total.shape[1] - 1)
    each = np.take_along_axis(weights, lobe[:, None, None], axis=1)[:, 0]
    share = each / np.maximum(each[:, leader : leader + 1], 1e-300)
    alive = passed & ~absorbed[:, None] & (uniform(key, np.uint64(5))[:, None] < share)
    drawn = draw(hair, out, found, lobe, np.stack([uniform(key, np.uint64(which)) for which in (2, 3, 4)]))
    azimuth = np.arctan2(np.einsum("nd,nd->n", towards, frames[:, 1]), np.einsum("nd,nd->n", towards, frames[:, 0]))
    around = azimuth + drawn.azimuth
    flat = np.sqrt((1.0 - drawn.sine) * (1.0 + drawn.sine))[:, None]
    local = flat * (np.cos(around)[:, None] * frames[:, 0] + np.sin(around)[:, None] * frames[:, 1])
    return alive, normalised(local + drawn.sine[:, None] * tangent)
