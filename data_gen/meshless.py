"""Light between samples that have no lightmap: hit tables that name the nearest sample, and hemispheres of depth.

Finds where rays go. What is made of it lives in `prt_bench/transport.py` and `prt_bench/depth.py`.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from data_gen.tracer import Tracer
from prt_bench.hemisphere import HemisphereSampler, tangent_frames
from prt_bench.points import SurfacePoints

_STEP = 1 << 19  # rays at once
_NEAREST = 4  # samples among which one that faces the right way is looked for
_SAME_WAY = 0.5


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
