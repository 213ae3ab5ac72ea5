"""Repeated timings: their statistics, and the three stages of a model in JAX. Needs no OpenGL."""

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.emitters import Emitters, irradiance
from prt_bench.errors import SpecError
from prt_bench.harmonic import HarmonicModel
from prt_bench.lights import emitters
from prt_bench.records import Stage, Timing

Key = TypeVar("Key", bound=Hashable)
Work = TypeVar("Work")


def interleaved(
    works: Mapping[Key, Work], clock: Callable[[Work], float], rounds: int, warmup: int
) -> dict[Key, Stage]:
    """Time every piece of work once a round, so that drift of the machine hits all alike; nobody is always first.

    `clock` runs one piece and returns milliseconds. The first `warmup` rounds are not counted. Raises `SpecError` for
    less than one round.
    """
    if rounds < 1:
        raise SpecError(f"timing needs at least one round, not {rounds}")
    order = list(works)
    samples: dict[Key, list[float]] = {key: [] for key in order}
    for round_ in range(warmup + rounds):
        turn = round_ % len(order)
        for key in order[turn:] + order[:turn]:
            elapsed = clock(works[key])
            if round_ >= warmup:
                samples[key].append(elapsed)
    return {key: stage_of(milliseconds) for key, milliseconds in samples.items()}


def stage_of(milliseconds: Sequence[float]) -> Stage:
    """Median and interquartile range of repeated timings."""
    low, median, high = np.percentile(milliseconds, (25, 50, 75))
    return Stage(float(median), float(high - low), len(milliseconds))


def time_stages(
    assets: Mapping[str, RuntimeAsset], ds: LightingDataset, rounds: int = 7, warmup: int = 2
) -> dict[str, Timing]:
    """Wall-clock timings of measure, transfer and reconstruct per asset, for the first lighting of `ds`.

    Compiled, in float32. Measuring is irradiance at the dense points times a given visibility (finding it is not
    counted) and the average over groups, the same for all assets that measure there, or the projection of the light onto
    harmonics. Rounds are interleaved over stages and assets. Raises `SpecError` for less than one round.
    """
    lights = jax.tree.map(lambda leaf: jnp.asarray(leaf[0], jnp.float32), emitters(ds.lightings[:1]))
    position, normal = (jnp.asarray(part, jnp.float32) for part in (ds.dense_points.position, ds.dense_points.normal))
    visibility = jnp.ones((len(ds.dense_points), lights.position.shape[0]), jnp.float32)
    groups = jnp.asarray(ds.groups)

    @jax.jit
    def measure(lights: Emitters, visibility: jax.Array) -> jax.Array:
        return irradiance(lights, position, normal, visibility)[groups].mean(axis=1)[None]

    works: dict[tuple[str, str], Callable[[], jax.Array]] = {("", "measure"): partial(measure, lights, visibility)}
    for label, asset in assets.items():
        model = asset.model()
        measuring = "", "measure"
        if isinstance(model, HarmonicModel):
            measuring = label, "measure"
            works[measuring] = partial(jax.jit(model.observe), lights)
        x = works[measuring]()
        transfer, reconstruct = jax.jit(model.transfer), jax.jit(model.reconstruct)
        u = transfer(x)
        works[label, "transfer"] = partial(transfer, x)
        works[label, "reconstruct"] = partial(reconstruct, u)
        works[label, "reconstruct"]()  # compiles

    def clock(work: Callable[[], jax.Array]) -> float:
        started = time.perf_counter()
        work().block_until_ready()
        return (time.perf_counter() - started) * 1e3

    stages = interleaved(works, clock, rounds, warmup)
    device = jax.devices()[0]
    return {
        label: Timing(
            api="jax",
            device=device.device_kind,
            software=device.platform == "cpu",
            clock="wall",
            resolution=None,
            stages={
                "measure": stages.get((label, "measure"), stages["", "measure"]),
                "transfer": stages[label, "transfer"],
                "reconstruct": stages[label, "reconstruct"],
            },
        )
        for label in assets
    }
