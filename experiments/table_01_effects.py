"""The cost of each kind of scene (Table 1 of Belcour et al. 2022): surfaces, subsurface scattering, hair, and all together.

Small bakes of one size: `svd-ridge` as published with 16 functions, a lightmap and rays as asked. Prints seconds of the bake
and what of them were rays and lights, what the plan had predicted, bytes of the bake's stores and of the asset, and a frame
without and with indirect light, beside the paper's figures for its scene of that kind (RTX 2080, 1024² texels, 128 lightings).
Times are to be compared along columns, not with the paper's: what carries over is the ratio of one kind to another.

    python experiments/table_01_effects.py [--texels 128] [--rays 64] [--lightings 32] [--strands 800] [--rounds 15]
"""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from _frames import PUBLISHED, arguments, table

import prt_bench as prt
from data_gen.scenes import hairball
from prt_bench.evaluate import errors
from prt_bench.frames import time_assets
from prt_bench.records import provenance
from prt_bench.runtime.runtime import Runtime
from prt_bench.scene import Scene
from prt_bench.spec import TimeSpec

BASIS = 16


class Paper(NamedTuple):
    """A column of the paper's Table 1: minutes of the bake, microseconds without indirect light and with 16 functions."""

    scene: str
    minutes: float
    without: float
    frame: float


CORNELL, DRAGON, HAIRBALL = (
    Paper("Cornell", 6.48, 221.0, 428.0),
    Paper("Dragon", 13.37, 418.0, 658.0),
    Paper("Hairball", 49.07, 8729.0, 9547.0),
)
HEAD = (
    "kind", "scene", "receivers", "error", "bake s", "rays s", "light s", "predicted s", "bake MB", "asset MB",
    "no indirect ms", "frame ms", "times", "paper's scene", "bake min", "frame µs", "times",
)  # fmt: skip


def main() -> None:
    parser = arguments(
        __doc__, None, data=False, scenario="point", texels=128, rays=64, lightings=32, strands=800, rounds=15
    )
    chosen = parser.parse_args()
    kinds: dict[str, tuple[Scene, Paper | None]] = {
        "surface": (prt.load_scene("cornell"), CORNELL),
        "subsurface": (prt.load_scene("candle"), DRAGON),
        "hair": (hairball.build(chosen.strands), HAIRBALL),
        "skin and hair": (prt.load_scene("bust"), None),
        "all of them": (prt.load_scene("medley"), None),
    }
    settings = {name: getattr(chosen, name) for name in ("scenario", "texels", "rays", "lightings")}
    warm(settings)
    lines, device = [], ""
    for kind, (scene, paper) in kinds.items():
        with TemporaryDirectory() as folder:
            line, device = study(scene, settings, TimeSpec(rounds=chosen.rounds), Path(folder))
            theirs = (None,) * 4 if paper is None else (
                paper.scene, f"{paper.minutes:.2f}", f"{paper.frame:.0f}", f"{paper.frame / paper.without:.2f}",
            )  # fmt: skip
            lines.append((kind, *line, *theirs))
    print(f"{device}, {os.cpu_count()} cores of {provenance()['cpu']}; {chosen.texels}² texels, {chosen.rays} rays,"
          f" {chosen.lightings} lightings and those held out; medians of {chosen.rounds} rounds\n")  # fmt: skip
    table(HEAD, lines)


def warm(settings: dict) -> None:
    """A bake whose compilation no row has to pay for."""
    with TemporaryDirectory() as folder:
        prt.bake(prt.load_scene("furnace"), **{**settings, "lightings": 2}, out=folder)


def study(scene: Scene, settings: dict, spec: TimeSpec, folder: Path) -> tuple[tuple, str]:
    """Cells of a row, and the device that drew."""
    started = time.perf_counter()
    ds = prt.bake(scene, **settings, out=folder)
    seconds = time.perf_counter() - started
    spent, cost = ds.metadata["seconds"], ds.metadata["predicted"]
    stored = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    asset = prt.method("svd-ridge", basis=BASIS, **PUBLISHED).fit(ds.split("train")).export(folder / "asset")
    runtime = Runtime(ds)
    *_, in_gl, _ = time_assets(ds, {BASIS: asset}, {BASIS: runtime.load(asset)}, spec)[BASIS]  # the last is JAX's
    assert in_gl.baseline is not None
    frame, without = in_gl.stages["frame"].median, in_gl.baseline.median
    cells = (
        scene.name, len(ds.points), f"{errors(None, ds.split('test'), asset).relative_rmse:.3f}", f"{seconds:.1f}",
        f"{spent['trace']:.1f}", f"{spent['light']:.1f}", f"{cost['seconds']:.1f}", f"{stored / 1e6:.1f}",
        f"{sum(asset.bytes.values()) / 1e6:.2f}", f"{without:.1f}", f"{frame:.1f}", f"{frame / without:.2f}",
    )  # fmt: skip
    return cells, f"{runtime.device}, {runtime.size[0]} × {runtime.size[1]} pixels"


if __name__ == "__main__":
    main()
