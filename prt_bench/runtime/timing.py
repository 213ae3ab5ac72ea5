"""Timing on OpenGL: what each pass and a whole frame cost, for several assets at once.

Rounds are interleaved, one pass of one asset after another, so that drift of the machine hits all alike. The clock is wall
time around `finish()` on a software renderer, whose timer queries mean nothing; a GPU gives timer queries as well.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Sequence

import moderngl

from prt_bench.errors import SpecError
from prt_bench.lights import Lighting
from prt_bench.records import Timing
from prt_bench.runtime.context import check
from prt_bench.runtime.indirect import LoadedAsset
from prt_bench.runtime.runtime import Runtime
from prt_bench.timing import stage_of

Clock = Callable[[moderngl.Context, Callable[[], None]], float]


def time_assets(
    runtime: Runtime, assets: Sequence[LoadedAsset], lighting: Lighting, rounds: int = 7, warmup: int = 2
) -> list[tuple[Timing, ...]]:
    """Timings of each asset under one lighting: one by wall clock, and on a GPU one more by timer queries.

    Stages: shadow (all shadow maps), measure, transfer, draw (shading, sky, tone map) and frame, which is all of these as
    a user would see them, without reading back; `baseline` is the frame without indirect light. Uploading the lighting is
    not counted. Raises `SpecError` for fewer than one round.
    """
    if rounds < 1:
        raise SpecError(f"timing needs at least one round, not {rounds}")
    lights = runtime.light(lighting)
    shared = {
        "shadow": lambda: runtime.shadows.run(lights),
        "measure": lambda: runtime.measurement.run(lights),
        "baseline": lambda: runtime.draw(lights),
    }
    works: list[tuple[tuple[int, str], Callable[[], None]]] = [((-1, name), work) for name, work in shared.items()]
    for index, asset in enumerate(assets):
        works.append(((index, "transfer"), asset.transfer_pass.run))
        works.append(((index, "draw"), lambda asset=asset: runtime.shade(lights, asset)))
        works.append(((index, "frame"), lambda asset=asset: runtime.draw(lights, asset)))
    clocks = {"wall": _wall} if runtime.software else {"wall": _wall, "timer-query": _timer_query}
    samples: dict[tuple[str, int, str], list[float]] = defaultdict(list)
    for round_ in range(-warmup, rounds):
        turn = round_ % len(works)  # nobody is always first
        for (owner, stage), work in works[turn:] + works[:turn]:
            for clock, measure in clocks.items():
                elapsed = measure(runtime.context, work)
                if round_ >= 0:
                    samples[clock, owner, stage].append(elapsed)
    check(runtime.context, "timing")

    def timing(clock: str, index: int) -> Timing:
        owners = {"shadow": -1, "measure": -1, "transfer": index, "draw": index, "frame": index}
        stages = {name: stage_of(samples[clock, owner, name]) for name, owner in owners.items()}
        baseline = stage_of(samples[clock, -1, "baseline"])
        return Timing("gl", runtime.device, runtime.software, clock, runtime.size, stages, baseline)

    return [tuple(timing(clock, index) for clock in clocks) for index in range(len(assets))]


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
