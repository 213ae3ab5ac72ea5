"""Streamed lightings: further lightings of a scenario, of which direct light alone is kept.

Shadow rays are all they cost. What indirect light they cause is the traced operator's to say, so that a method may learn
from thousands of lightings where a bake of as many would not fit.
"""

import hashlib
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import zarr
from jaxtyping import Int

from data_gen.decisions import Plan
from data_gen.direct import direct_irradiance
from data_gen.journal import Journal, create_array
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.emitters import Emitters
from prt_bench.lights import Lighting, emitters
from prt_bench.points import SurfacePoints
from prt_bench.progress import track

BLOCK = 64
"""Lightings that are lit and stored together."""


def write_streamed(
    group: zarr.Group,
    journal: Journal,
    lightings: Sequence[Lighting],
    transport: Transport,
    tracer: Tracer,
    settings: Plan,
    dense: SurfacePoints,
    groups: Int[np.ndarray, "M s"],
) -> list[str]:
    """Fill `streamed_direct` [n, S] and `streamed_measured` [n, M] in W/m² and return the blocks' digests.

    Light is grey, each emitter of the mean intensity of its channels: every channel of a linear model sees the same geometry.
    Blocks in the journal are done already.
    """
    count, samples = len(lightings), len(transport.samples)
    direct = create_array(group, "streamed_direct", (count, samples), (BLOCK, samples), np.float32)
    measured = create_array(group, "streamed_measured", (count, len(groups)), (count, len(groups)), np.float32)
    blocks = [slice(at, min(at + BLOCK, count)) for at in range(0, count, BLOCK)]
    missing = [(-1 - index, rows) for index, rows in enumerate(blocks) if -1 - index not in journal.done]
    for chunk, rows in track(missing, f"stream {transport.scene.name}"):
        lights = _grey(emitters(lightings[rows]))
        shadows = settings.needs_shadow_rays(transport.scene, lights)
        at_samples, at_dense = (
            direct_irradiance(tracer, points, lights, shadows)[..., 0] for points in (transport.samples, dense)
        )
        seen = at_dense[:, groups].mean(axis=2)
        direct[rows], measured[rows] = at_samples, seen
        journal.add(chunk, digest=hashlib.sha256(at_samples.tobytes() + seen.tobytes()).hexdigest())
    return [journal.done[-1 - index]["digest"] for index in range(len(blocks))]


def _grey(lights: Emitters) -> Emitters:
    mean = jnp.mean(jnp.asarray(lights.intensity), axis=-1, keepdims=True)
    grey = jnp.broadcast_to(mean, jnp.shape(lights.intensity))
    return eqx.tree_at(lambda tree: tree.intensity, lights, grey)
