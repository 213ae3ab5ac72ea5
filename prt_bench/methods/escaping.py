"""Transfer vectors of distant light: from the rays that escape, and through all bounces by the traced operator."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from prt_bench.dataset import Transport
from prt_bench.errors import FitError, SpecError
from prt_bench.methods.operator import respond
from prt_bench.points import SurfacePoints
from prt_bench.visibility import escaping_transfer

_POINTS = 1 << 14  # points whose rays are in memory at once


def transfer_vectors(
    transport: Transport, albedo: Float[Array, "S C"], order: int
) -> tuple[Float[np.ndarray, "T K"], Float[np.ndarray, "T C K"]]:
    """What distant light of each harmonic causes at the receivers: direct, and by all bounces. In steradians, float32.

    The bounces take the same way as any other light: direct transfer at the gather samples goes through the operator, a
    column for each harmonic. Raises `FitError` for a transport that kept no directions of its rays, `SpecError` for hair.
    """
    traced = transport.traced
    direct = transport.spread(direct_transfer(traced, traced.receiver_hits, traced.receivers, order))
    if transport.receiver_hits is transport.sample_hits:
        at_samples = direct
    else:
        at_samples = direct_transfer(transport, transport.sample_hits, transport.samples, order)
    return direct, respond(transport, albedo, at_samples)


def direct_transfer(transport: Transport, table: Any, points: SurfacePoints, order: int) -> Float[np.ndarray, "P K"]:
    """`escaping_transfer` of all points of a hit table, some of them in memory at a time."""
    if points.clearance is not None:
        raise SpecError(
            f"scene '{transport.scene.name}' has hair, which transfer vectors do not know; use a method that measures light"
        )
    if transport.sampler is None:
        raise FitError(f"the transport of '{transport.scene.name}' kept no directions of its rays; bake it again")
    out = np.empty((len(points), order * order), np.float32)
    for at in range(0, len(points), _POINTS):
        rows = slice(at, at + _POINTS)
        escaped = np.asarray(table[rows]) == len(transport.samples) + 1
        out[rows] = escaping_transfer(escaped, transport.sampler, at, points.normal[rows], order)
    return out
