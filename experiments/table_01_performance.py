"""Performance, storage and bake time (Table 1 of Belcour et al. 2022), on our scenes.

`svd-ridge` as published (mean, mono-channel, light over the norm of its measured values, ridge 1e-3) with 4, 16 and 64
functions: 128 lightings, 256 measured values, 128² texels. Every scene is baked anew into an empty folder, so that the bake is
all of it. Each model is exported once: errors, bytes and times are those of that file, loaded by the OpenGL runtime and by
JAX, timed in interleaved rounds. Measuring is the paper's fake G-buffer, transfer its matrix transfer; the frame with no
indirect light is its `No GI`. A first fit compiles.

    python experiments/table_01_performance.py [--scenes cornell suzanne] [--basis 4 16 64] [--rounds 31]
"""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
from _frames import PUBLISHED, arguments, bake, table

import prt_bench as prt
from prt_bench.evaluate import errors
from prt_bench.frames import time_assets
from prt_bench.records import provenance
from prt_bench.runtime.runtime import Runtime
from prt_bench.spec import TimeSpec

COLUMNS = (
    "scene", "functions", "rel. RMSE", "no indirect ms", "frame ms", "measure ms", "transfer ms", "draw ms",
    "JAX measure ms", "JAX transfer ms", "JAX reconstruct ms", "basis MB", "matrix kB", "runtime MB", "bake s", "fit s",
)  # fmt: skip


def main() -> None:
    parser = arguments(
        __doc__, None, data=False, scenes=["cornell", "suzanne"], scenario="point", basis=[4, 16, 64], rounds=31
    )
    settings = parser.parse_args()
    lines, device = [], ""
    for scene in settings.scenes:
        with TemporaryDirectory() as folder:
            ds = bake(scene, settings.scenario, Path(folder))
            runtime, spec = Runtime(ds), TimeSpec(rounds=settings.rounds)
            device = f"{runtime.device}, {runtime.size[0]} × {runtime.size[1]} pixels"
            lines += study(scene, ds, settings.basis, runtime, spec, Path(folder))
    about = provenance()
    print(f"{device}, {os.cpu_count()} cores of {about['cpu']}; medians of {settings.rounds} rounds\n")
    table(COLUMNS, [[f"{cell:.2f}" if isinstance(cell, float) else cell for cell in line] for line in lines])


def study(
    scene: str, ds: prt.LightingDataset, sizes: list[int], runtime: Runtime, spec: TimeSpec, folder: Path
) -> list[list]:
    """One line for each size of the basis, all timed together."""
    train, test, assets, seconds = ds.split("train"), ds.split("test"), {}, {}
    for size in sizes:
        started = time.perf_counter()
        model = jax.block_until_ready(prt.method("svd-ridge", basis=size, **PUBLISHED).fit(train))
        seconds[size] = time.perf_counter() - started
        assets[size] = model.export(folder / f"{size}")
    loaded = {size: runtime.load(asset) for size, asset in assets.items()}
    timings = time_assets(ds, assets, loaded, spec)
    lines = []
    for size, asset in assets.items():
        *gl, in_jax = timings[size]
        shown = gl[-1]  # on a GPU timer queries, on a software renderer the wall clock
        milliseconds = {name: stage.median for name, stage in shown.stages.items()}
        stages = {name: stage.median for name, stage in in_jax.stages.items()}
        basis = asset.bytes["basis"]
        lines.append([
            scene, size, f"{errors(None, test, asset).relative_rmse:.3f}", shown.baseline.median, milliseconds["frame"],
            milliseconds["measure"], milliseconds["transfer"], milliseconds["draw"],
            stages["measure"], stages["transfer"], stages["reconstruct"],
            basis / 1e6, (sum(asset.bytes.values()) - basis) / 1e3, loaded[size].bytes / 1e6,
            float(sum(ds.metadata["seconds"].values())), seconds[size],
        ])  # fmt: skip
    return lines


if __name__ == "__main__":
    main()
