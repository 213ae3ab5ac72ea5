"""What a bake will cost, from counts and from rates measured here and now, and what it did cost beside that.

Compilation counts: that of one kernel is timed, once a process. A bake like one that this process made before has its kernels
at hand, and takes less.
"""

import resource
import sys
import time
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from data_gen.decisions import Cost, Plan
from data_gen.effects.hair import predicted_cost
from data_gen.effects.subsurface import measured_rates
from data_gen.gather import PROBES
from data_gen.strand_atlas import strand_rows
from data_gen.tracer import Tracer
from prt_bench.lights import AREA_SAMPLES, ENVIRONMENT_SAMPLES
from prt_bench.scene import Scene
from prt_bench.strands import TEXELS
from prt_bench.transport import GatherOperator

_LIGHT_SAMPLES = {"area": AREA_SAMPLES, "environment": ENVIRONMENT_SAMPLES}
_NODE_SHARE = 0.2  # share of receivers that become nodes, for predictions
_COVERAGE = 0.75  # share of lightmap texels that charts cover, for predictions
_KERNELS = 18  # like the one that is timed, that a bake compiles the worth of
_SHOWN = (
    ("gather_rays", 1e6, "M"),
    ("shadow_rays", 1e6, "M"),
    ("disk_bytes", 1e6, "MB"),
    ("memory_bytes", 1e6, "MB"),
    ("seconds", 1.0, "s"),
)


def predict(
    draft: Plan, scene: Scene, scenario: str, lightings: int, dense: int, workers: int | None, streamed: int
) -> Cost:
    """Cost from counts and from rates measured here and now on this scene."""
    strands = 0 if scene.strands is None else len(scene.strands) * TEXELS  # texels of theirs
    surfaces = draft.texels if scene.strands is None else draft.texels - strand_rows(scene, draft.texels)
    receivers = int(_COVERAGE * surfaces**2) + strands
    samples = receivers if strands else int(_COVERAGE * draft.gather_texels**2)
    shared = draft.gather_texels == draft.texels
    traced = receivers - strands if shared else receivers + samples
    # Samples again for what enters media, or falls on hair.
    lit = receivers + dense + samples * (2 if scene.translucent or strands else 1)
    columns = lightings * draft.channels
    if draft.node_rays:
        traced -= receivers
    gather_rays = (traced + draft.vertices * len(scene.mesh.vertices)) * draft.rays
    gather_rays += int(_NODE_SHARE * receivers) * draft.node_rays
    lit_points = lit * lightings + (samples + dense) * streamed
    shadow_rays = 0 if draft.convex == "outside" else lit_points * _LIGHT_SAMPLES.get(scenario, 1)
    tracer = Tracer(scene, workers)
    rates = _rates(scene, tracer)
    gathered = _NODE_SHARE * receivers * draft.node_rays if draft.node_rays else receivers * draft.rays
    sums = (samples * min(draft.bounces, 16) * draft.rays + gathered) * columns
    pairs = 4 * receivers * columns
    disk = 2 * pairs + pairs // 4 + gather_rays * 2 + 4 * samples * streamed
    gather_rays += PROBES * (receivers + (0 if shared else samples))
    seconds = _KERNELS * _compiling() + (gather_rays + 0.5 * shadow_rays) / rates.ray
    # Bounds of what bounces leave out go over the table once for each.
    seconds += (draft.bounces + 1) * (0 if strands else samples) * draft.rays / rates.entry
    if scene.translucent:
        starts = (receivers + (0 if shared else samples) + draft.vertices * len(scene.mesh.vertices)) * draft.rays
        walk = measured_rates(scene, workers)
        gather_rays += int(starts * walk.queries)
        disk += int(2 * starts * walk.share * walk.channels)
        seconds += starts * walk.seconds
        entries = walk.share * samples * draft.rays
        seconds += (draft.bounces + 1) * entries * walk.channels / rates.entry
        sums += entries * columns * min(draft.bounces, 16) + walk.share * receivers * draft.rays * columns
    if strands:
        queries, sky, alone, shadow = predicted_cost(scene, draft.rays, tracer)
        entries = strands * draft.rays
        gather_rays += queries
        disk += 4 * entries * draft.channels
        # Shadow rays among fibres take longer than others: of all that are lit, three times each strand texel.
        from_strands = shadow_rays * 3 * strands / lit
        shadow_rays += sky
        seconds += alone + from_strands * (shadow - 0.5 / rates.ray)
        sums += entries * columns * min(draft.bounces, 16)
    seconds += sums / rates.sum
    memory = int(6e8) + 12 * samples * columns * 4 + 6 * min(receivers, 1 << 14) * columns * 4
    return Cost(gather_rays, shadow_rays, disk, memory, seconds)


class _Rates(NamedTuple):
    """Rays, entries of a hit table and, where many lightings stand beside each other, gathered values per second."""

    ray: float
    entry: float
    sum: float


def _rates(scene: Scene, tracer: Tracer) -> _Rates:
    """Each timed on a small batch, here and now."""
    rng = np.random.default_rng(0)
    origins = rng.uniform(scene.bounds[0], scene.bounds[1], (1 << 17, 3)).astype(np.float32)
    directions = rng.normal(size=origins.shape).astype(np.float32)
    tracer.intersect(origins[:1024], directions[:1024])
    started = time.perf_counter()
    tracer.intersect(origins, directions)
    ray_rate = len(origins) / (time.perf_counter() - started)
    gather = GatherOperator.from_hits(rng.integers(0, 4096, (1024, 64)), 4096)
    entry_rate, sum_rate = (_gather_rate(gather, columns) for columns in (1, 256))
    return _Rates(ray_rate, entry_rate, sum_rate)


def _gather_rate(gather: GatherOperator, columns: int) -> float:
    """Values per second that a table gathers from so many columns."""
    light = jnp.ones((4096, columns), jnp.float32)
    _gathered(gather, light).block_until_ready()
    started = time.perf_counter()
    _gathered(gather, light).block_until_ready()
    return 1024 * 64 * columns / (time.perf_counter() - started)


@jax.jit
def _gathered(gather: GatherOperator, light: Array) -> Array:
    return gather(light)


@cache
def _compiling() -> float:
    """Seconds to compile one kernel, timed once in this process."""
    gather, light = GatherOperator.from_hits(np.zeros((64, 64), int), 64), jnp.ones((64, 64), jnp.float32)
    kernel = jax.jit(lambda gather, light: gather(gather(light)))
    started = time.perf_counter()
    kernel.lower(gather, light).compile()
    return time.perf_counter() - started


def spent(gather_rays: int, shadow_rays: int, stores: Sequence[Path], seconds: float) -> dict[str, float]:
    """What a bake did cost, in the fields of `Cost`; bytes are those of `stores`, and of the process at its peak."""
    disk = sum(file.stat().st_size for store in stores for file in store.rglob("*") if file.is_file())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {
        "gather_rays": gather_rays,
        "shadow_rays": shadow_rays,
        "disk_bytes": disk,
        "memory_bytes": peak,
        "seconds": seconds,
    }


def comparison(predicted: Mapping[str, float], actual: Mapping[str, float]) -> str:
    """Aligned lines of what was predicted beside what it came to; `actual` also says what was not done anew."""
    rows = [("", "predicted", "actual")]
    for name, scale, unit in _SHOWN:
        rows.append((name.replace("_", " "), *(f"{part[name] / scale:.1f} {unit}" for part in (predicted, actual))))
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = ["  ".join((a.ljust(widths[0]), b.rjust(widths[1]), c.rjust(widths[2]))) for a, b, c in rows]
    lines += ["the rays of the scene had been traced before"] * bool(actual["traced_before"])
    lines += ["an interrupted bake was gone on with: actual rays and seconds are those since"] * bool(actual["resumed"])
    return "\n".join(lines)
