"""Tracing many rays at few receivers, and interpolating the rest where their hit tables say that light is smooth.

Cells of the lightmap are refined from coarse to fine. At a cell's corners, edge middles and middle everything that its rays
meet is summed up in some forty numbers; where the corners fail to predict the others' by more than a tolerance, the cell is
halved, down to single texels. So rays go where shadows begin, and a floor gets few. What the numbers cannot see, and detail
between nodes, is left out: `experiments/transfer_bake_speed.py` measures the error against texels traced one by one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from data_gen.gather import trace_hits
from data_gen.lattice import Cells, regions
from data_gen.resolve import HitResolver
from data_gen.tracer import Tracer
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.transport import GatherOperator
from prt_bench.visibility import escaping_transfer

ORDER = 5
"""Bands of the transfer vectors that are compared; light of higher frequency may be less smooth than they say."""
_STEP = 1 << 13  # nodes whose rays are in memory at once


class Seen(NamedTuple):
    """What the rays of n points meet: `sky` [n, K], the transfer vector of distant light; `surface` [n, F], gathered patterns;
    and the same from each half of the rays. Their differences measure noise."""

    sky: Float[np.ndarray, "n K"]
    surface: Float[np.ndarray, "n F"]
    noise: Float[np.ndarray, "n 2"]


class Interpolation(NamedTuple):
    """J `nodes` among T receivers, by index, and for each receiver four of them, by their place in `nodes`, with shares."""

    nodes: Int[np.ndarray, " J"]
    corner: Int[np.ndarray, "T 4"]
    weight: Float[np.ndarray, "T 4"]


def interpolate(
    lightmap: Lightmap,
    points: SurfacePoints,
    buried: Bool[np.ndarray, " T"],
    tolerance: float,
    look: Callable[[Int[np.ndarray, " n"]], Seen],
) -> Interpolation:
    """Choose nodes; `look` is called once for each level of cells, with receivers not seen before.

    A cell is smooth when at its edge middles and middle neither the sky nor the surfaces seen differ from what its corners
    predict by more than `tolerance` times their root mean square over the coarsest nodes, with the noise of both allowed for.
    """
    home = regions(lightmap, points, buried)
    receiver = np.full(home.size, -1, np.int64)
    receiver[lightmap.texel] = np.arange(len(points))
    node = np.full(home.size, -1, np.int64)
    corner, weight = np.full((len(points), 4), -1, np.int64), np.zeros((len(points), 4), np.float32)
    order: list[np.ndarray] = []
    seen: list[Seen] = []
    count, scale = 0, None
    cells = Cells.whole(home)
    while len(cells):
        small = cells.small
        tested = cells.complete() & ~small
        wanted = np.unique(np.concatenate([cells[small].texels()[0], cells[tested].nodes().ravel()]))
        fresh = wanted[node[wanted] < 0]
        node[fresh] = count + np.arange(len(fresh))
        count += len(fresh)
        order.append(receiver[fresh])
        seen.append(look(receiver[fresh]))
        known = Seen(*(np.concatenate(parts) for parts in zip(*seen, strict=True)))
        scale = _squares(known) if scale is None else scale
        candidates = cells[tested]
        smooth = _smooth(candidates, node, known, tolerance, scale)
        accepted = candidates[smooth]
        texel, owner = accepted.texels()
        around, share = accepted.between(texel, owner)
        corner[receiver[texel]], weight[receiver[texel]] = node[around], share
        rest = np.flatnonzero(~small)
        failed = np.ones(len(rest), bool)
        failed[np.flatnonzero(tested[rest])[smooth]] = False
        cells = cells[rest[failed]].halved().occupied()
    chosen = np.concatenate(order) if order else np.zeros(0, np.int64)
    corner[chosen] = np.arange(count)[:, None]
    weight[chosen] = (1.0, 0.0, 0.0, 0.0)
    return Interpolation(chosen, corner, weight)


def _smooth(
    cells: Cells, node: Int[np.ndarray, " texels"], seen: Seen, tolerance: float, scale: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, " n"]:
    """Which complete cells are predicted well from their corners."""
    places = node[cells.nodes()].reshape(-1, 9)
    weights = cells.corner_weights().reshape(-1, 9, 4)
    ends = places[:, [0, 2, 6, 8]]
    smooth = np.ones(len(cells), bool)
    for middle in (1, 3, 4, 5, 7):
        share = weights[:, middle]
        for kind, values in enumerate((seen.sky, seen.surface)):
            missed = values[places[:, middle]] - np.einsum("nc,nck->nk", share, values[ends])
            noise = seen.noise[places[:, middle], kind] + np.sum(share**2 * seen.noise[ends, kind], axis=1)
            smooth &= np.sum(missed**2, axis=1) <= tolerance**2 * scale[kind] + noise
    return smooth


def _squares(seen: Seen) -> Float[np.ndarray, "2"]:
    """Mean squares of what is seen of sky and surfaces."""
    return np.array([np.mean(np.sum(values.astype(float) ** 2, axis=1)) for values in (seen.sky, seen.surface)])


class Looker:
    """Traces receivers in the order they are asked for, keeps their hits in `table`, and sums up what they met."""

    def __init__(
        self,
        tracer: Tracer,
        resolver: HitResolver,
        sampler: HemisphereSampler,
        points: SurfacePoints,
        samples: SurfacePoints,
        table: Any,
    ) -> None:
        self._trace = tracer, resolver, sampler
        self._points, self.table, self._at = points, table, 0
        self._patterns = jnp.asarray(_patterns(samples), jnp.float32)

    def __call__(self, chosen: Int[np.ndarray, " n"]) -> Seen:
        """Trace the receivers `chosen`; `table` grows by as many rows."""
        parts = [self._some(chosen[at : at + _STEP]) for at in range(0, max(len(chosen), 1), _STEP)]
        return Seen(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _some(self, chosen: np.ndarray) -> Seen:
        tracer, resolver, sampler = self._trace
        points, first, rays = self._points[chosen], self._at, sampler.local.shape[1]
        hits = trace_hits(tracer, resolver, sampler, points, first)
        self.table.append(hits)
        self._at += len(chosen)
        halves = slice(0, rays // 2), slice(rays // 2, rays)
        escaped = hits == resolver.samples + 1
        sky = [
            escaping_transfer(escaped[:, part], sampler, first, points.normal, ORDER, part)
            for part in (slice(None), *halves)
        ]
        padded = np.zeros((-(-len(hits) // 256) * 256, rays), hits.dtype)  # few shapes to compile for
        padded[: len(hits)] = hits
        surface = [
            np.asarray(GatherOperator.from_hits(padded[:, part], resolver.samples)(self._patterns))[: len(hits)]
            for part in halves
        ]
        noise = [np.sum((a - b) ** 2, axis=1) / 4.0 for a, b in (sky[1:], surface)]
        return Seen(sky[0], 0.5 * (surface[0] + surface[1]), np.stack(noise, axis=1))


def _patterns(samples: SurfacePoints) -> Float[np.ndarray, "S 9"]:
    """Radiosity of the gather samples under smooth light: from all around in each channel, growing along an axis in space, and
    falling in along it."""
    grey = samples.albedo.mean(axis=1, keepdims=True)
    low, high = samples.position.min(axis=0), samples.position.max(axis=0)
    place = (samples.position - low) / max(float(np.max(high - low)), np.finfo(float).tiny)
    return np.concatenate([samples.albedo, grey * place, grey * (0.5 + 0.5 * samples.normal)], axis=1)
