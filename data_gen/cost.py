"""What a bake will cost, from counts and from rates measured here and now, and what it did cost beside that."""

import resource
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from data_gen.decisions import Cost, Plan
from data_gen.effects.hair import predicted_cost
from data_gen.effects.subsurface import predicted_walks
from data_gen.strand_atlas import strand_rows
from data_gen.tracer import Tracer
from prt_bench.lights import AREA_SAMPLES, ENVIRONMENT_SAMPLES
from prt_bench.scene import Scene
from prt_bench.strands import TEXELS
from prt_bench.transport import GatherOperator

_LIGHT_SAMPLES = {"area": AREA_SAMPLES, "environment": ENVIRONMENT_SAMPLES}
_NODE_SHARE = 0.2  # share of receivers that become nodes, for predictions
_COVERAGE = 0.75  # share of lightmap texels that charts cover, for predictions
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
    ray_rate, sum_rate = _rates(scene, tracer)
    gathered = _NODE_SHARE * receivers * draft.node_rays if draft.node_rays else receivers * draft.rays
    sums = (samples * min(draft.bounces, 16) * draft.rays + gathered) * columns
    seconds = (gather_rays + 0.5 * shadow_rays) / ray_rate + sums / sum_rate
    pairs = 4 * receivers * columns
    disk = 2 * pairs + pairs // 4 + gather_rays * 2 + 4 * samples * streamed
    if scene.translucent:
        starts = (receivers + (0 if shared else samples) + draft.vertices * len(scene.mesh.vertices)) * draft.rays
        walks, queries = predicted_walks(scene, draft.channels)
        gather_rays += int(starts * queries)
        disk += int(2 * starts * walks)
        seconds += starts * queries / ray_rate
    if strands:
        queries, sky, alone, shadow = predicted_cost(scene, draft.rays, tracer)
        entries = strands * draft.rays
        gather_rays += queries
        disk += 4 * entries * draft.channels
        # Shadow rays among fibres take longer than others: of all that are lit, three times each strand texel.
        from_strands = shadow_rays * 3 * strands / lit
        shadow_rays += sky
        seconds += alone + from_strands * (shadow - 0.5 / ray_rate)
        seconds += entries * columns * min(draft.bounces, 16) / sum_rate
    memory = int(6e8) + 12 * samples * columns * 4 + 6 * min(receivers, 1 << 14) * columns * 4
    return Cost(gather_rays, shadow_rays, disk, memory, seconds)


def _rates(scene: Scene, tracer: Tracer) -> tuple[float, float]:
    """Rays per second on this scene and gathered values per second, each timed on a small batch."""
    rng = np.random.default_rng(0)
    origins = rng.uniform(scene.bounds[0], scene.bounds[1], (1 << 17, 3)).astype(np.float32)
    directions = rng.normal(size=origins.shape).astype(np.float32)
    tracer.intersect(origins[:1024], directions[:1024])
    started = time.perf_counter()
    tracer.intersect(origins, directions)
    ray_rate = len(origins) / (time.perf_counter() - started)

    gather = GatherOperator.from_hits(rng.integers(0, 4096, (1024, 64)), 4096)
    light = jnp.ones((4096, 256), jnp.float32)
    _gathered(gather, light).block_until_ready()
    started = time.perf_counter()
    _gathered(gather, light).block_until_ready()
    return ray_rate, 1024 * 64 * 256 / (time.perf_counter() - started)


@jax.jit
def _gathered(gather: GatherOperator, light: Array) -> Array:
    return gather(light)


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
