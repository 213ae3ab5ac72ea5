"""Light between samples that have no lightmap: hit tables that name the nearest sample, hemispheres of depth, walls.

Finds where rays go. What is made of it lives in `prt_bench/transport.py` and `prt_bench/depth.py`.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from data_gen.tracer import Tracer
from prt_bench.hemisphere import HemisphereSampler, tangent_frames
from prt_bench.points import SurfacePoints

_STEP = 1 << 19  # rays at once
_NEAREST = 4  # samples among which one that faces the right way is looked for
_SAME_WAY = 0.5
_GRAZING = 0.05  # cosine


def nearest_hits(
    tracer: Tracer, points: SurfacePoints, normals: Float[np.ndarray, "F 3"], rays: int, seed: int = 0
) -> Int[np.ndarray, "S R"]:
    """For `rays` cosine-weighted rays from each of S samples the sample nearest to their hit; `normals` are the faces'.

    Of the four nearest, the nearest that faces as the surface there does is taken, so that nothing is read from behind a wall
    or round a corner. S marks a ray that carries nothing, S + 1 one that escaped, as in `GatherOperator`.
    """
    sampler, tree = HemisphereSampler.create(rays, seed), KDTree(points.position)
    out = np.empty((len(points), rays), np.int32)
    step = max(_STEP // rays, 1)
    for start in range(0, len(points), step):
        rows = slice(start, min(start + step, len(points)))
        direction = np.asarray(sampler.directions(start, points.normal[rows])).reshape(-1, 3)
        origin = np.repeat(points.position[rows] + tracer.offset * points.normal[rows], rays, axis=0)
        hits = tracer.intersect(origin, direction)
        met = hits.front & (hits.face >= 0)
        place = (origin + direction * np.where(met, hits.distance, 0.0)[:, None])[met]
        _, near = tree.query(place, k=min(_NEAREST, len(points)), workers=-1)
        near = near.reshape(len(place), -1)
        facing = np.einsum("rkd,rd->rk", points.normal[near], normals[hits.face[met]]) > _SAME_WAY
        found = np.where(hits.face >= 0, len(points), len(points) + 1)
        found[met] = near[np.arange(len(near)), np.argmax(facing, axis=1)]
        out[rows] = found.reshape(-1, rays)
    return out


def hemispheres(
    tracer: Tracer, points: SurfacePoints, directions: Float[np.ndarray, "d 3"]
) -> Float[np.ndarray, "S d"]:
    """Distance in m to what each sample sees along `directions` in its unturned `tangent_frames`; float32.

    Where a ray escapes it is inf.
    """
    out = np.empty((len(points), len(directions)), np.float32)
    step = max(_STEP // len(directions), 1)
    for start in range(0, len(points), step):
        rows = slice(start, min(start + step, len(points)))
        frame = tangent_frames(points.normal[rows], np.zeros(rows.stop - start))
        turned = np.einsum("kd,pdx->pkx", directions, frame).reshape(-1, 3)
        origin = np.repeat(points.position[rows] + tracer.offset * points.normal[rows], len(directions), axis=0)
        out[rows] = tracer.intersect(origin, turned).distance.reshape(-1, len(directions))
    return out


def hidden_by_walls(tracer: Tracer, points: SurfacePoints, lift: float) -> Callable[[int], Bool[np.ndarray, " S"]]:
    """Which samples do not see that of an index, from places `lift` in m above both: furniture that is lower hides nothing."""
    above = points.position + lift * points.normal

    def hidden(index: int) -> Bool[np.ndarray, " S"]:
        return tracer.occluded(above, above[index] - above)

    return hidden


def walls_around(
    tracer: Tracer, points: SurfacePoints, normals: Float[np.ndarray, "F 3"]
) -> Float[np.ndarray, "S 4 2"]:
    """What stands on the surface of each sample along ±tangent and ±bitangent, as lines; `normals` are the faces'.

    A place at x along the axes lies behind wall i where x · walls[i] > 1, in 1/m; 0 where there is none. Frames are unturned
    `tangent_frames`. Lines are as long as the surface, so a place that is seen past the end of a wall counts as behind it.
    """
    frame = tangent_frames(points.normal, np.zeros(len(points)))
    along = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    origin = np.repeat(points.position + tracer.offset * points.normal, len(along), axis=0)
    hits = tracer.intersect(origin, np.einsum("ka,pax->pkx", along, frame[:, :2]).reshape(-1, 3))
    across = np.einsum("pax,pkx->pka", frame[:, :2], normals[hits.face].reshape(-1, len(along), 3))
    met = np.einsum("pka,ka->pk", across, along)
    inverse = (1.0 / np.maximum(hits.distance, tracer.offset)).reshape(-1, len(along))
    # At a grazing angle the line is that of a wall across.
    slope = np.where((np.abs(met) > _GRAZING)[:, :, None], across / np.where(met == 0, 1.0, met)[:, :, None], along)
    return inverse[:, :, None] * slope
