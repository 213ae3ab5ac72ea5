"""Direct light with shadow rays: irradiance at points from many lightings, or only which emitters they see."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from data_gen.tracer import Tracer
from prt_bench.emitters import Emitters, strength
from prt_bench.lights import Lighting
from prt_bench.lights import emitters as batched_emitters
from prt_bench.points import SurfacePoints
from prt_bench.scene import Scene


def direct_irradiance(
    tracer: Tracer, points: SurfacePoints, emitters: Emitters, shadow_rays: bool = True
) -> Float[np.ndarray, "N P 3"]:
    """Irradiance [N, P, 3] in W/m² at `points` from each of N lightings, float32.

    Emitters that cannot reach a point (behind it, outside the cone, dark) cost no ray; `shadow_rays=False` skips the rest
    too, where the planner has shown that nothing can occlude.
    """
    position = np.asarray(points.position, np.float32)
    normal = np.asarray(points.normal, np.float32)
    origins, fibre = _origins(tracer, points), _fibre(points)
    single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), emitters)
    out = np.empty((len(single.position), len(points), 3), np.float32)

    def light(index: int) -> None:
        lit = jax.tree.map(lambda leaf: leaf[index], single)
        weight = np.array(_strength(lit, position, normal, fibre))
        if shadow_rays:
            _remove_shadowed(weight, tracer, origins, lit, points)
        out[index] = weight @ lit.intensity

    with tracer.pool() as executor:
        list(executor.map(light, range(len(out))))
    return out


def visibility(tracer: Tracer, points: SurfacePoints, emitters: Emitters) -> Bool[np.ndarray, "N P Q"]:
    """Which emitters of each lighting light which points: False behind them, outside of a cone, in shadow and in the dark."""
    position, normal = np.asarray(points.position, np.float32), np.asarray(points.normal, np.float32)
    origins, fibre = _origins(tracer, points), _fibre(points)
    single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), emitters)
    seen = []
    for index in range(len(single.position)):
        lit = jax.tree.map(lambda leaf, at=index: leaf[at], single)
        weight = np.array(_strength(lit, position, normal, fibre)) * (lit.intensity.max(axis=1) > 0)
        _remove_shadowed(weight, tracer, origins, lit, points)
        seen.append(weight > 0)
    return np.stack(seen)


def seen(
    scene: Scene, points: SurfacePoints, lightings: Sequence[Lighting], workers: int | None = None
) -> Bool[np.ndarray, "N P Q"]:
    """Which emitters of lightings light which points of a scene: what `prt_bench.chain` holds fixed. See `visibility`."""
    return visibility(Tracer(scene, workers), points, batched_emitters(lightings))


def _fibre(points: SurfacePoints) -> Bool[np.ndarray, " P"] | None:
    """Which points lie on strands of hair; None where none does."""
    return None if points.clearance is None else points.clearance > 0


def _origins(tracer: Tracer, points: SurfacePoints) -> Float[np.ndarray, "P 3"]:
    """Where shadow rays start: off the surface by the tracer's offset, on the axis of a strand."""
    position, normal = np.asarray(points.position, np.float32), np.asarray(points.normal, np.float32)
    lifted = position + np.float32(tracer.offset) * normal
    fibre = _fibre(points)
    return lifted if fibre is None else np.where(fibre[:, None], position, lifted)


def _remove_shadowed(
    weight: Float[np.ndarray, "P Q"],
    tracer: Tracer,
    origins: Float[np.ndarray, "P 3"],
    emitters: Emitters,
    points: SurfacePoints,
) -> None:
    """Set the weight of occluded pairs to zero, in place."""
    bright = np.asarray(emitters.intensity).max(axis=1) > 0
    point, emitter = np.nonzero((weight > 0) & bright)
    place = np.asarray(emitters.position)[emitter]
    at_infinity = place[:, 3:] == 0
    start = origins[point]
    # Short of the light by the offset, so that a lamp resting on a surface is not hidden by it.
    segment = np.where(at_infinity, place[:, :3] * np.float32(tracer.reach), place[:, :3] - start)
    length = np.linalg.norm(segment, axis=1, keepdims=True)
    segment *= np.maximum(1.0 - tracer.offset / np.maximum(length, np.float32(tracer.offset)), 0.0)
    if points.clearance is not None:
        start, segment = _out_of_tubes(start, segment, points[point], tracer.offset)
    hidden = tracer.occluded(start, segment)
    weight[point[hidden], emitter[hidden]] = 0.0


def _out_of_tubes(
    start: Float[np.ndarray, "n 3"], segment: Float[np.ndarray, "n 3"], points: SurfacePoints, offset: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Rays that start on the axes of strands, moved across them out of their tubes towards where they go."""
    assert points.clearance is not None
    across = segment - np.einsum("nd,nd->n", segment, points.normal)[:, None] * points.normal
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    lift = np.where(points.clearance > 0, points.clearance + offset, 0.0)[:, None] * across
    return (start + lift).astype(np.float32), (segment - lift).astype(np.float32)


@jax.jit
def _strength(emitters: Emitters, position: Array, normal: Array, fibre: Array | None = None) -> Array:
    return strength(emitters, position, normal, fibre)
