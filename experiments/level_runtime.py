"""Mazes of blocks as a runtime has them: milliseconds of each stage against the number of blocks, and a frame.

Stages are b, r and light (both kinds of it), one bounce, on one core: in JAX as it is differentiated, and in NumPy as it is
prepared for frames, which also has the step from direct light and albedo; beside the source's x86 times. Then the same in
OpenGL with what comes before and after: shadow maps of one point light, direct light at the samples, the padded image, drawing.
How far results are from those in JAX is printed with them. Last, what leaving out weak pairs costs and saves.

    python experiments/level_runtime.py [--blocks 1 11 41 200]

Draws a maze of 11 blocks from within: direct light, indirect light after all bounces, and both. The dictionary is
built if it is not in the cache.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from _frames import arguments, table
from PIL import Image
from threadpoolctl import threadpool_limits

import prt_bench as prt
from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.scenes.maze import ALBEDO
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.dictionary import Dictionary, standard
from prt_bench.modular.level import Level, LevelTransfer, maze, transfer
from prt_bench.modular.prepared import PreparedLevel
from prt_bench.runtime import headless, renderer
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera
from prt_bench.timing import interleaved

PAPER_MS = {11: 1.4, 41: 6.2}
BOUNCES = 6
TOLERANCES = (0.0, 1e-3, 1e-2)
SIZE = (640, 480)
SHOWN = 11
STAGES = ("b", "r", "light", "all")
CORE_HEADS = (
    *(f"JAX {name}" for name in STAGES),
    *(f"NumPy {name}" for name in (*STAGES, "with albedo")),
    "NumPy − JAX",
)


def main() -> None:
    settings = arguments(__doc__, "levels.webp", data=False, blocks=[1, 11, 41, 200]).parse_args()
    dictionary = standard()
    one_core(dictionary, settings.blocks)
    print()
    opengl(dictionary, settings.blocks)
    print()
    left_out(dictionary, [count for count in settings.blocks if count > 1])
    draw(dictionary, settings.out)


def milliseconds(works: Mapping, finish: Callable[[object], object]) -> dict:
    """Medians of all works by turns; `finish` waits for the result of one."""

    def clock(work: Callable[[], object]) -> float:
        started = time.perf_counter()
        finish(work())
        return (time.perf_counter() - started) * 1e3

    return {key: stage.median for key, stage in interleaved(works, clock, 25, 3).items()}


def one_core(dictionary: Dictionary, counts: list[int]) -> None:
    """The table of JAX and NumPy, each maze by itself, so that none finds another's matrices in the caches."""
    with single_core():
        rows = [(*core_row(transfer(maze(count, seed=0), dictionary)), PAPER_MS.get(count, "")) for count in counts]
    table(("blocks", *CORE_HEADS, "source, x86"), rows)


@contextmanager
def single_core() -> Iterator[None]:
    """One core for all that runs within."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    with threadpool_limits(1):
        yield
    os.sched_setaffinity(0, cores)


def core_row(operator: LevelTransfer) -> tuple:
    """One level: its blocks, and what `CORE_HEADS` say."""
    prepared, count = PreparedLevel(operator), len(operator.kind)
    radiosity = np.random.default_rng(0).random((count, operator.solid.shape[1], 3), np.float32)
    radiosity *= np.asarray(operator.solid)[:, :, None]
    light = np.ascontiguousarray(np.swapaxes(radiosity, 1, 2)[prepared.order])
    given = jnp.asarray(radiosity)
    b = operator.coefficients(given)
    calls = {
        LevelTransfer.coefficients: (given,), LevelTransfer.arriving: (b,),
        LevelTransfer.indirect: (b, operator.arriving(b)), once_through: (given,),
    }  # fmt: skip
    works = {call.__name__: partial(jax.jit(call), operator, *values) for call, values in calls.items()}
    in_jax = milliseconds(works, jax.block_until_ready)
    stages = {
        "b": lambda: prepared.coefficients(light), "r": prepared.arriving, "light": prepared.indirect,
        "all": lambda: (prepared.coefficients(light), prepared.arriving(), prepared.indirect()),
        "with albedo": lambda: prepared(light, 1.0),
    }  # fmt: skip
    in_numpy = milliseconds(stages, lambda result: result)
    wanted = np.swapaxes(np.asarray(once_through(operator, given)), 1, 2)[prepared.order]
    away = np.abs(prepared(light, 1.0) - wanted).max() / wanted.max()
    times = (*(f"{value:.2f}" for value in in_jax.values()), *(f"{value:.3f}" for value in in_numpy.values()))
    return count, *times, f"{away:.0e}"


def once_through(operator: LevelTransfer, radiosity: jax.Array) -> jax.Array:
    """All three stages."""
    b = operator.coefficients(radiosity)
    return operator.indirect(b, operator.arriving(b))


def loaded(level: Level, operator: LevelTransfer) -> LevelRuntime:
    """The level's own scene in OpenGL."""
    side = operator.dictionary.side
    points = block_samples(level, side, ALBEDO)
    return LevelRuntime(LevelAtlas(level, side), operator, scene_of(level, ALBEDO), points, EDGE, SIZE)


def opengl(dictionary: Dictionary, counts: list[int]) -> None:
    """The table of OpenGL."""
    rows = [opengl_row(maze(count, seed=0), dictionary) for count in counts]
    print(f"OpenGL, {renderer(headless())}, frames of {SIZE[0]} × {SIZE[1]}, one bounce")
    names = ("shadow", "direct", "b", "r", "light", "image", "draw", "frame")
    table(("blocks", *names, "MB", f"OpenGL − JAX, {BOUNCES} bounces"), rows)


def opengl_row(level: Level, dictionary: Dictionary) -> tuple:
    """One maze, with the light in its first block."""
    operator = transfer(level, dictionary)
    runtime = loaded(level, operator)
    lighting = prt.Lighting([prt.PointLight((0.3, 0.6, 0.2), (20.0, 19.0, 17.0))])
    found = stages(runtime, lighting)
    direct, light = runtime.solve(lighting, BOUNCES)
    albedo = block_samples(level, dictionary.side, ALBEDO).albedo.reshape(light.shape)
    wanted = np.asarray(operator(jnp.asarray(direct), jnp.asarray(albedo, jnp.float32), BOUNCES))
    away = np.abs(light - wanted).max() / wanted.max()
    return len(level.cells), *(f"{value:.2f}" for value in found.values()), f"{runtime.bytes / 1e6:.1f}", f"{away:.0e}"


def stages(runtime: LevelRuntime, lighting: prt.Lighting) -> dict[str, float]:
    """Milliseconds of each pass of a frame with one bounce, and of all."""
    lights = runtime.light(lighting)
    works = {
        "shadow": lambda: runtime.shadows.run(lights), "direct": lambda: runtime.measure(lights), "b": runtime.read,
        "r": runtime.arrive, "light": runtime.respond, "image": runtime.pad, "draw": lambda: runtime.shade(lights),
        "frame": lambda: runtime.draw(lights),
    }  # fmt: skip
    return milliseconds(works, lambda _: runtime.context.finish())


def left_out(dictionary: Dictionary, counts: list[int]) -> None:
    """Pairs kept at each tolerance, and what that changes in the light of six lamps after four bounces."""
    rows = []
    for count in counts:
        level = maze(count, seed=0)
        operators = [transfer(level, dictionary, tolerance=tolerance) for tolerance in TOLERANCES]
        random = np.random.default_rng(0)
        direct = np.zeros((*operators[0].solid.shape, 6), np.float32)
        for lamp, block in enumerate(random.integers(0, count, 6)):
            direct[block, :, lamp] = np.asarray(operators[0].solid)[block] * random.random(direct.shape[1])
        every, *others = (np.asarray(operator(jnp.asarray(direct), 0.7, 4)) for operator in operators)
        kept = [f"{len(operator.pairs)} ({operator.pairs.nbytes / 1e6:.1f} MB)" for operator in operators]
        errors = [f", {np.linalg.norm(light - every) / np.linalg.norm(every):.0e}" for light in others]
        rows.append((count, *(pair + error for pair, error in zip(kept, ["", *errors], strict=True))))
    table(("blocks", *(f"tolerance {tolerance:g}: pairs, error" for tolerance in TOLERANCES)), rows)


def draw(dictionary: Dictionary, path: Path) -> None:
    """Frames from within a maze, of a lit room and the next: direct, indirect, both."""
    level = maze(SHOWN, seed=0)
    runtime = loaded(level, transfer(level, dictionary))
    lit, eye, target = (
        EDGE * (np.array(level.cells[at]) + offset)
        for at, offset in ((0, (-0.3, 0.0, 0.1)), (3, (0.2, 0.15, 0.3)), (2, (-0.3, -0.15, 0.0)))
    )
    lighting = prt.Lighting([prt.PointLight(lit, (9.0, 8.5, 7.5))])
    runtime.look_from(Camera(tuple(eye), tuple(target), fov_y=65.0))
    parts = ({"indirect": False}, {"direct": False}, {})
    shown = [runtime.picture(lighting, BOUNCES, exposure=0.5, **part)[::2, ::2] for part in parts]
    gap = np.full((len(shown[0]), 8, 3), 255, np.uint8)
    Image.fromarray(np.concatenate([shown[0], gap, shown[1], gap, shown[2]], axis=1)).save(path, quality=85)


if __name__ == "__main__":
    main()
