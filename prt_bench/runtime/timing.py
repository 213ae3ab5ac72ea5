"""Timing on OpenGL: what each pass and a whole frame cost, for several assets at once.

The clock is wall time around `finish()` on a software renderer, whose timer queries mean nothing; a GPU gives timer
queries as well.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial

import moderngl

from prt_bench.lights import Lighting
from prt_bench.records import Stage, Timing
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import LoadedAsset
from prt_bench.runtime.runtime import Runtime
from prt_bench.timing import interleaved


def time_assets(
    loaded: Mapping[str, LoadedAsset], lighting: Lighting, rounds: int = 7, warmup: int = 2
) -> dict[str, tuple[Timing, ...]]:
    """Timings of assets of one runtime under one lighting: by wall clock, and on a GPU by timer queries too.

    Stages: shadow (all shadow maps), measure, transfer, draw (shading, sky, tone map) and frame, which is all of these
    as a user would see them, without reading back; `baseline` is the frame without indirect light. An asset that includes
    direct light has no shadow stage and no baseline. Uploading the lighting is not counted. Rounds are interleaved over
    passes and assets. Raises `SpecError` for less than one round.
    """
    (runtime,) = {asset.runtime for asset in loaded.values()}
    lights = runtime.light(lighting)
    works: dict[tuple[str, str], Callable[[], None]] = {
        ("", "shadow"): partial(runtime.shadows.run, lights),
        ("", "baseline"): partial(runtime.draw, lights),
    }
    for label, asset in loaded.items():
        works[label, "measure"] = partial(asset.measure, lights)
        works[label, "transfer"] = asset.transfer
        works[label, "draw"] = partial(runtime.shade, lights, asset)
        works[label, "frame"] = partial(runtime.draw, lights, asset)

    runtime.draw(lights)  # every stage starts from shadow maps of these lights
    clocks = {"wall": _wall} if runtime.software else {"wall": _wall, "timer-query": _timer_query}
    stages = {
        name: interleaved(works, partial(clock, runtime.context), rounds, warmup) for name, clock in clocks.items()
    }
    check(runtime.context, "timing")
    return {
        label: tuple(_timing(runtime, name, stages[name], label, loaded[label].needs_shadows) for name in clocks)
        for label in loaded
    }


def _timing(runtime: Runtime, clock: str, stages: Mapping[tuple[str, str], Stage], label: str, shadows: bool) -> Timing:
    return Timing(
        api="gl",
        device=runtime.device,
        software=runtime.software,
        clock=clock,
        resolution=runtime.size,
        stages={
            **({"shadow": stages["", "shadow"]} if shadows else {}),
            "measure": stages[label, "measure"],
            "transfer": stages[label, "transfer"],
            "draw": stages[label, "draw"],
            "frame": stages[label, "frame"],
        },
        baseline=stages["", "baseline"] if shadows else None,
    )


def _wall(context: moderngl.Context, work: Callable[[], None]) -> float:
    context.finish()
    started = time.perf_counter()
    work()
    context.finish()
    return (time.perf_counter() - started) * 1e3


def _timer_query(context: moderngl.Context, work: Callable[[], None]) -> float:
    query = context.query(time=True)
    with query:
        work()
    return query.elapsed * 1e-6
