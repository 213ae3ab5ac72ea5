"""The hit table: cosine-weighted rays from every point, resolved to the gather sample each one meets.

A hit's lightmap position is jittered by up to half a texel before the nearest texel is taken, which is bilinear
interpolation in expectation at the cost of one index per ray. The jitter never leaves the chart that was hit, so nothing is
interpolated across a seam or through a wall.
"""

import numpy as np
from jaxtyping import Bool, Int, UInt

from data_gen.resolve import HitResolver
from data_gen.tracer import Tracer
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.points import SurfacePoints

NOWHERE = -1
"""The face of points in the air."""
_RAYS_PER_STEP = 1 << 18
"""Enough to amortise a few hundred microseconds of dispatch."""
PROBES = 16
"""Rays that tell whether a point is buried."""


def buried(tracer: Tracer, points: SurfacePoints, seed: int) -> Bool[np.ndarray, " P"]:
    """Whether points lie inside another body: most rays from them meet the back of a surface."""
    directions = HemisphereSampler.create(PROBES, seed).directions(0, points.normal)
    origins = np.repeat(points.position + tracer.offset * points.normal, PROBES, axis=0)
    hits = tracer.intersect(origins, directions.reshape(-1, 3))
    back = np.isfinite(hits.distance) & ~hits.front
    return back.reshape(-1, PROBES).sum(axis=1) > PROBES // 2


def trace_hits(
    tracer: Tracer,
    resolver: HitResolver,
    sampler: HemisphereSampler,
    points: SurfacePoints,
    first: int | Int[np.ndarray, " P"],
) -> Int[np.ndarray, "P R"] | UInt[np.ndarray, "P R"]:
    """Hit table rows of `points`, whose global indices start at `first` or are given. Same result for any number of workers.

    A ray that carries nothing holds the number of samples, one that escaped one more. Where a normal is not that of the
    point's face, rays below the face carry nothing: the surface hides them. Points in the air have the face `NOWHERE`.
    """
    rays = sampler.local.shape[1]
    step = max(_RAYS_PER_STEP // rays, 1)
    origins = (points.position + tracer.offset * points.normal).astype(np.float32)
    turns = sampler.turns(first, points.normal)
    table = np.empty((len(points), rays), resolver.sample.dtype)
    flat = resolver.normals[points.face]
    tilted = (points.face != NOWHERE) & (np.abs(points.normal - flat).max(axis=1, initial=0.0) > 1e-6)

    def trace(start: int) -> None:
        rows = slice(start, min(start + step, len(points)))
        origin, directions = sampler.rays(origins[rows], turns[rows])
        found = tracer.trace(np.asarray(origin), np.asarray(directions))
        table[rows] = resolver(found, directions, sampler.jitter, turns.chosen[rows]).reshape(-1, rays)
        some = np.flatnonzero(tilted[rows])
        if some.size:
            away = np.asarray(directions).reshape(-1, rays, 3)[some]
            below = np.einsum("prd,pd->pr", away, flat[rows][some]) <= 0
            table[start + some] = np.where(below, resolver.samples, table[start + some])

    with tracer.pool(spare=True) as executor:
        list(executor.map(trace, range(0, len(points), step)))
    return table
