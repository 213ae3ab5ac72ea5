"""Repeated timings: their statistics, and the three stages of a model in JAX. Needs no OpenGL."""

import time
from collections import defaultdict
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.errors import SpecError
from prt_bench.lights import Lighting, emitters, irradiance
from prt_bench.records import Stage, Timing


def stage_of(milliseconds: Sequence[float]) -> Stage:
    """Median and interquartile range of repeated timings."""
    low, median, high = np.percentile(milliseconds, (25, 50, 75))
    return Stage(float(median), float(high - low), len(milliseconds))


def time_jax(
    assets: Sequence[RuntimeAsset], ds: LightingDataset, lighting: Lighting, rounds: int = 7, warmup: int = 2
) -> list[Timing]:
    """Wall-clock timings in float32 of measure, transfer and reconstruct for each asset, compiled, one lighting at a time.

    Measuring is unoccluded irradiance at the dense points times a given visibility (finding it is not counted) and the
    average over groups; it is the same for all assets. Rounds are interleaved over stages and assets. Raises `SpecError`
    for fewer than one round.
    """
    if rounds < 1:
        raise SpecError(f"timing needs at least one round, not {rounds}")
    lights = jax.tree.map(lambda leaf: jnp.asarray(leaf[0], jnp.float32), emitters([lighting]))
    dense = [jnp.asarray(part, jnp.float32) for part in (ds.dense_points.position, ds.dense_points.normal)]
    visibility = jnp.ones((len(ds.dense_points), lights.position.shape[0]), jnp.float32)
    groups = jnp.asarray(ds.groups)
    measure = jax.jit(lambda lights, visibility: irradiance(lights, *dense, visibility)[groups].mean(axis=1)[None])
    x = measure(lights, visibility)

    works: list[tuple[tuple[int, str], Callable[[], jax.Array]]] = [((-1, "measure"), lambda: measure(lights, visibility))]
    for index, asset in enumerate(assets):
        model = asset.model()
        transfer, reconstruct = jax.jit(model.transfer), jax.jit(model.reconstruct)
        u = transfer(x)
        works.append(((index, "transfer"), lambda transfer=transfer: transfer(x)))
        works.append(((index, "reconstruct"), lambda reconstruct=reconstruct, u=u: reconstruct(u)))
    samples: dict[tuple[int, str], list[float]] = defaultdict(list)
    for round_ in range(-warmup, rounds):
        turn = round_ % len(works)  # nobody is always first
        for key, work in works[turn:] + works[:turn]:
            started = time.perf_counter()
            work().block_until_ready()
            if round_ >= 0:
                samples[key].append((time.perf_counter() - started) * 1e3)

    device = jax.devices()[0]
    name = f"JAX {device.platform} ({device.device_kind})"
    owners = [{"measure": -1, "transfer": index, "reconstruct": index} for index in range(len(assets))]
    return [
        Timing(
            "jax", name, device.platform == "cpu", "wall", None,
            {stage: stage_of(samples[owner, stage]) for stage, owner in stages.items()},
        )
        for stages in owners
    ]  # fmt: skip
