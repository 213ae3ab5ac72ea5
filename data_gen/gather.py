"""The hit table: cosine-weighted rays from every point, resolved to the gather sample each one meets.

A hit's lightmap position is jittered by up to half a texel before the nearest texel is taken, which is bilinear
interpolation in expectation at the cost of one index per ray. The jitter never leaves the chart that was hit, so nothing is
interpolated across a seam or through a wall.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from data_gen.atlas import texel_lookup
from data_gen.hemisphere import HemisphereSampler
from data_gen.tracer import RAYS_PER_CALL, Hits, Tracer
from prt_bench.points import Lightmap, SurfacePoints


@dataclass(frozen=True)
class HitResolver:
    """From ray hits to gather samples, by lightmap coordinates.

    `corner` [F, 6] holds, per face, the texel coordinates of corner 0 and the edge vectors to corners 1 and 2;
    `lookup` [res²] the sample nearest to each texel within its chart, −1 where there is none.
    """

    resolution: int
    corner: Float[np.ndarray, "F 6"]
    lookup: Int[np.ndarray, " texels"]
    face_chart: Int[np.ndarray, " F"]
    sample_chart: Int[np.ndarray, " S1"]
    samples: int

    @classmethod
    def create(cls, lightmap: Lightmap, samples: SurfacePoints) -> "HitResolver":
        """Tables for hits on the scene that `lightmap` unwraps; `samples` are its covered texels."""
        uv = lightmap.corner_uv.astype(np.float32) * lightmap.resolution
        corner = np.concatenate([uv[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
        lookup = texel_lookup(lightmap)
        # Texels without a sample hold −1, which finds the last entry here: a chart that no face belongs to.
        sample_chart = np.append(lookup.receiver_chart, -2)
        return cls(lightmap.resolution, corner, lookup.receiver, lookup.face_chart, sample_chart, len(samples))

    def resolve(self, hits: Hits, jitter: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Sample index of each hit; `samples` for rays that carry nothing."""
        corner = self.corner[hits.face]
        s = corner[:, 0] + hits.u * corner[:, 2] + hits.v * corner[:, 4]
        t = corner[:, 1] + hits.u * corner[:, 3] + hits.v * corner[:, 5]
        found = self._nearest(s + jitter[:, 0], t + jitter[:, 1])
        strayed = np.flatnonzero(self.sample_chart[found] != self.face_chart[hits.face])
        if strayed.size:
            found[strayed] = self._nearest(s[strayed], t[strayed])
        carries = hits.front & (self.sample_chart[found] == self.face_chart[hits.face])
        return np.where(carries, found, np.int32(self.samples))

    def _nearest(self, s: Float[np.ndarray, " n"], t: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        last = self.resolution - 1
        column = np.clip(s.astype(np.int32), 0, last)
        row = np.clip(t.astype(np.int32), 0, last)
        return self.lookup[row * self.resolution + column]


def trace_hits(
    tracer: Tracer, resolver: HitResolver, sampler: HemisphereSampler, points: SurfacePoints, first: int
) -> Int[np.ndarray, "P R"]:
    """Hit table rows of `points`, whose global indices start at `first`. Same result for any number of workers."""
    rays = sampler.local.shape[1]
    step = max(RAYS_PER_CALL // rays, 1)
    origins = (points.position + tracer.offset * points.normal).astype(np.float32)
    table = np.empty((len(points), rays), np.int32)

    def trace(start: int) -> None:
        rows = slice(start, min(start + step, len(points)))
        directions, jitter = sampler.directions(first + start, points.normal[rows])
        hits = tracer.nearest(np.repeat(origins[rows], rays, axis=0), directions.reshape(-1, 3))
        table[rows] = resolver.resolve(hits, jitter.reshape(-1, 2)).reshape(-1, rays)

    with tracer.pool() as executor:
        list(executor.map(trace, range(0, len(points), step)))
    return table
