"""Hair: a sparse, light-independent map from irradiance at gather samples to light that leaves strands after several fibres.

Paths (`data_gen/hair_paths.py`) are traced once from each texel of a strand. Light that falls on a path's last fibre, or on the
surface where it ends, leaves the texel: those places are drawn from, as many as a point has rays, and the scale of a row says
how many there were.

Between fibres light is followed by direction. Of direct light a mean around the fibre is stored, which has none: over how open
the hair is at that place (`StrandPaths.openness`) it is the mean radiance that comes in there from outside. That is what a path
sees which goes out of the hair, to a surface or to the sky; so the last fibre of each such path counts by one over its
openness, and no other does. Light that is the same everywhere outside then stays so, but for places that hardly see out.

What rays from surfaces see of hair is the same mean. Checks, predictions and tables in the store are here; their use is
`prt_bench.transport.Scattering`.
"""

import json
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from data_gen.hair_paths import BLOCK, LONGEST, Fate, Followed, StrandPaths
from data_gen.journal import Journal, create_array
from data_gen.medium_walk import uniform, walk_keys
from data_gen.resolve import HitResolver
from data_gen.strand_atlas import strand_rows
from data_gen.tracer import Tracer
from prt_bench.errors import SpecError
from prt_bench.hemisphere import hashed
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.progress import say, track
from prt_bench.scene import Scene
from prt_bench.store import write_array
from prt_bench.strands import TEXELS
from prt_bench.walks import WalkTable

VERSION = 2  # part of the transport's key: raise when the same inputs would give other paths
_PATHS = 1 << 17  # paths that are traced and stored together
_LOOKING = 1 << 15  # texels whose openness is found and stored together
_PILOT = 2 * BLOCK  # paths that are followed to predict what all of them cost
_SKY_RAYS = 64  # from each texel, that tell how open the hair is there
_REFLECTED, _ONWARD, _DRAWN = np.uint64(21), np.uint64(22), np.uint64(23)  # choose random numbers


def check_hair(
    scene: Scene, texels: int, gather_texels: int | str | None, rays: int | str, vertices: bool, node_rays: int
) -> None:
    """Raise `SpecError` or `SceneError` for settings of a bake that hair does not have."""
    strand_rows(scene, texels)
    if rays == "auto":
        raise SpecError(f"scene '{scene.name}' has hair, whose noise no pilot measures; give rays a number")
    if gather_texels not in (None, "auto", texels):
        raise SpecError(
            f"scene '{scene.name}' has hair, whose texels are its gather samples; leave gather_texels out, or give it {texels}"
        )
    if vertices:
        raise SpecError(
            f"scene '{scene.name}' has hair, which has texels but no vertices of its own; leave vertices out"
        )
    if node_rays:
        raise SpecError(f"scene '{scene.name}' has hair, between whose texels light is not smooth; leave node_rays out")


def predicted_events(scene: Scene) -> float:
    """Mean number of fibres that a path meets, roughly: what fibres absorb ends it, or the hair around it.

    Hair of the optical thickness τ, the mean number of fibres across its hull (4V/S times the fibres' width per volume), is
    left after τ + τ² / 2 of them where nothing is absorbed.
    """
    strands = scene.strands
    assert strands is not None
    width = float(np.sum(strands.segments * 2.0 * strands.radius[strands.owner[strands.first]]))
    try:
        hull = ConvexHull(strands.nodes)
        thickness = np.pi * width / hull.area
    except (QhullError, ValueError):  # flat, or too few
        thickness = 0.0
    most = max(max(scene.materials[index].albedo) for index in np.unique(strands.material))
    alive = 1.0 / (1.0 - most) if most < 1 else np.inf
    return float(1.0 + min(thickness + 0.5 * thickness**2, alive))


class Rates(NamedTuple):
    """Measured on all workers together: seconds of a path, its mean number of rays, and seconds of a shadow ray.

    Threads wait for each other, so that a path on two cores takes more than half of what it takes on one.
    """

    path: float
    rays: float
    shadow: float


def measured_rates(scene: Scene, tracer: Tracer) -> Rates:
    """Some paths and shadow rays from texels all over the strands, timed here and now, for predictions."""
    assert scene.strands is not None
    texel = np.random.default_rng(0).integers(0, len(scene.strands) * TEXELS, _PILOT)
    keys = hashed(np.arange(_PILOT, dtype=np.uint64))
    paths = StrandPaths(scene, scene.strands, tracer, _Nowhere(), 1 if scene.achromatic else 3)
    paths.openness(texel[:1], 1, 0)  # so that what is built for the first rays is not timed
    started, before = time.perf_counter(), tracer.nearest
    paths.follow(texel, keys)
    between = time.perf_counter()
    paths.openness(texel, 1, 0)
    ended = time.perf_counter()
    return Rates((between - started) / _PILOT, (tracer.nearest - before) / _PILOT, (ended - between) / _PILOT)


class _Nowhere:
    """In the place of a resolver: no surface has samples, and every fibre the same."""

    samples = 0

    def __call__(self, hits: object, towards: Float[np.ndarray, "n 3"], *_: object) -> Int[np.ndarray, " n"]:
        return np.zeros(len(towards), np.int32)


def predicted_cost(scene: Scene, rays: int, tracer: Tracer) -> tuple[int, int, float, float]:
    """Rays of all paths, those that look for the sky, seconds of both, and those of one shadow ray from a strand."""
    assert scene.strands is not None
    texels, rates = len(scene.strands) * TEXELS, measured_rates(scene, tracer)
    seconds = texels * (rays * rates.path + _SKY_RAYS * rates.shadow)
    return int(texels * rays * rates.rays), texels * _SKY_RAYS, seconds, rates.shadow


def decision(scene: Scene, rays: int) -> tuple[str, str, str]:
    """What the planner says of hair: what, how and why."""
    assert scene.strands is not None
    return (
        "hair",
        f"{rays} paths per texel",
        f"{len(scene.strands)} strands of {TEXELS} texels; a path meets some {predicted_events(scene):.0f} fibres",
    )


def write_strand_paths(
    group: zarr.Group,
    journal: Journal,
    first: int,
    scene: Scene,
    tracer: Tracer,
    lightmap: Lightmap,
    samples: SurfacePoints,
    rays: int,
    seed: int,
    bodies: WalkTable | None,
) -> None:
    """Trace and store the paths of all strand texels, `rays` of each; journal entries are numbered from `first`.

    `bodies` are walks through translucent bodies from the samples, which paths that end on such bodies go on along.
    """
    assert scene.strands is not None
    assert samples.clearance is not None
    resolver = HitResolver.create(scene.mesh, lightmap, samples)
    channels = 1 if scene.achromatic else 3
    paths = StrandPaths(scene, scene.strands, tracer, resolver, channels)
    rows = np.flatnonzero(samples.clearance > 0)
    child = group.require_group("strands/receivers")
    write_array(child, "rows", rows.astype(np.int32))
    write_array(child, "material", scene.mesh.material[samples.face[rows]].astype(np.int32))
    size = max(_PATHS // rays, 1)
    create_array(
        child, "ends", (len(rows), channels, rays), (min(size, len(rows)), channels, rays), resolver.sample.dtype
    )
    create_array(child, "scale", (len(rows), channels, 2), (min(size, len(rows)), channels, 2), np.float32)
    chunks = [slice(at, min(at + size, len(rows))) for at in range(0, len(rows), size)]
    table = _Table(paths, samples, rays, seed, bodies, _openness(child, journal, first + len(chunks), paths, seed))
    missing = [(first + i, part) for i, part in enumerate(chunks) if first + i not in journal.done]
    for number, part in track(missing, f"paths in the hair of {scene.name}"):
        ends, scale, fates = table.rows(part)
        child["ends"][part], child["scale"][part] = ends, scale  # pyright: ignore[reportIndexIssue]
        journal.add(number, fates=fates.tolist())
    found = np.sum([journal.done[first + i]["fates"] for i in range(len(chunks))], axis=0)
    group["strands"].attrs["fates"] = json.dumps({fate.name.lower(): found[:, fate].tolist() for fate in Fate})
    left = found[:, [Fate.ALIVE, Fate.LOST]].sum() / found.sum()
    if left > 0:
        say(f"hair of {scene.name}: {left:.1e} of the paths neither left nor were absorbed after {LONGEST} rays")


def _openness(
    group: zarr.Group, journal: Journal, first: int, paths: StrandPaths, seed: int
) -> Float[np.ndarray, " texels"]:
    """How open the hair is at every texel of strands, stored part by part under journal numbers from `first`."""
    count = len(paths.strands) * TEXELS
    create_array(group, "open", (count,), (min(_LOOKING, count),), np.float32)
    parts = [np.arange(at, min(at + _LOOKING, count)) for at in range(0, count, _LOOKING)]
    missing = [(first + i, part) for i, part in enumerate(parts) if first + i not in journal.done]
    for number, texel in track(missing, f"openness of the hair of {paths.scene.name}"):
        group["open"][texel[0] : texel[-1] + 1] = paths.openness(texel, _SKY_RAYS, seed)  # pyright: ignore[reportIndexIssue]
        journal.add(number)
    return np.asarray(group["open"][:])  # pyright: ignore[reportIndexIssue]


class _Table:
    """Rows of the table of one scene's strand texels."""

    def __init__(
        self,
        paths: StrandPaths,
        samples: SurfacePoints,
        rays: int,
        seed: int,
        bodies: WalkTable | None,
        openness: Float[np.ndarray, " texels"],
    ) -> None:
        self.paths, self.albedo, self.rays, self.seed = paths, samples.albedo, rays, seed
        self.bodies = None if bodies is None else np.asarray(bodies.ends[:])
        self.open = np.ones(len(samples))
        self.open[-len(openness) :] = openness
        self.body_row = np.full(len(samples), -1)
        if bodies is not None:
            self.body_row[bodies.rows] = np.arange(len(bodies.rows))

    def rows(self, part: slice) -> tuple[Int[np.ndarray, "p D R"], Float[np.ndarray, "p D 2"], Int[np.ndarray, "D F"]]:
        """Samples, scales and counts of fates of some strand texels."""
        texel = np.arange(part.start, part.stop)
        keys = walk_keys(texel, self.rays, self.seed).ravel()
        followed = self.paths.follow(np.repeat(texel, self.rays), keys)
        channels, slots = self.paths.channels, self.rays // 2
        ends = np.full((len(texel), channels, self.rays), self.paths.resolver.samples, self.paths.resolver.sample.dtype)
        scale = np.zeros((len(texel), channels, 2), np.float32)
        turn = uniform(hashed(2 * texel[:, None].astype(np.uint64) + np.arange(2, dtype=np.uint64)), _DRAWN).ravel()
        for channel in range(channels):
            path, sample, on_fibre = self._sources(followed, keys, channel)
            # Of k open rays among n, (n + 1) / (k + 1) is 1 / openness on average, where n / k is more.
            through = (_SKY_RAYS + 1.0) / (_SKY_RAYS * self.open[sample] + 1.0)
            weight = np.where(on_fibre, through, 1.0)
            group = path // slots  # texel by texel, each with two halves of its paths
            order = np.argsort(group, kind="stable")
            total = np.bincount(group, weight, 2 * len(texel))
            ahead = np.concatenate([[0.0], np.cumsum(weight[order])])
            count = np.bincount(group, minlength=2 * len(texel))
            last = np.cumsum(count)
            # Evenly spaced along the weights of a half, from a random start: each visit is drawn by its weight on average.
            wanted = (np.arange(slots) + turn[:, None]) * total[:, None] / slots + ahead[last - count][:, None]
            drawn = np.searchsorted(ahead, wanted, side="right") - 1
            drawn = np.clip(drawn, (last - count)[:, None], np.maximum(last - 1, 0)[:, None])
            some = count > 0
            halves = np.full((2 * len(texel), slots), self.paths.resolver.samples, ends.dtype)
            halves[some] = sample[order][drawn[some]]
            ends[:, channel] = halves.reshape(len(texel), -1)
            scale[:, channel] = (total / slots).reshape(-1, 2)
        fates = np.stack([np.bincount(column, minlength=len(Fate)) for column in followed.fate.T])
        return ends, scale, fates

    def _sources(
        self, followed: Followed, keys: np.ndarray, channel: int
    ) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " v"], Bool[np.ndarray, " v"]]:
        """Paths, samples whose irradiance leaves along them, on fibres and, by their albedo, on surfaces; which are fibres."""
        visits, index = followed.visits, hashed(keys[followed.visits.path])
        reflected = uniform(index, _REFLECTED) < self.albedo[visits.sample, channel]
        last = np.full(len(keys), -1)
        on_fibres = np.flatnonzero(~visits.surface)
        last[visits.path[on_fibres]] = on_fibres  # later visits take the place of earlier ones
        went_out = np.isin(followed.fate[:, channel], (Fate.ESCAPED, Fate.SURFACE)) & (last >= 0)
        kept = visits.passed[:, channel] & visits.surface & reflected
        kept[last[went_out]] = True
        path, sample, fibre = visits.path[kept], visits.sample[kept].astype(np.int64), ~visits.surface[kept]
        if self.bodies is None:
            return path, sample, fibre
        inside = np.flatnonzero(visits.passed[:, channel] & visits.surface & (self.body_row[visits.sample] >= 0))
        medium, walks = min(channel, self.bodies.shape[1] - 1), self.bodies.shape[2]
        chosen = (uniform(index[inside], _ONWARD) * walks).astype(np.int64)
        through = self.bodies[self.body_row[visits.sample[inside]], medium, chosen].astype(np.int64)
        back = through < self.paths.resolver.samples
        return (
            np.concatenate([path, visits.path[inside][back]]),
            np.concatenate([sample, through[back]]),
            np.concatenate([fibre, np.zeros(back.sum(), bool)]),
        )


def fates_of(group: zarr.Group) -> Mapping[str, list[int]]:
    """What became of the paths of a transport store, by channel."""
    return json.loads(str(group["strands"].attrs["fates"]))
