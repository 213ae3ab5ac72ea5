"""A translucent statue under lights behind it (Figures 1 and 9 of Belcour et al. 2022): direct, indirect, sum and reference.

Bakes the scene `statue` and fits `svd-ridge` as published, linearly and in gamma space, and with a matrix per channel, the
settings of `settings.py` that suit it, `operator-ridge` and `reduced-rank`. Prints seconds of the bake and of each fit, rays,
bytes, what became of the walks, and errors of held-out light on everything and on the stone alone, as they are and as
displayed. A part of the rays' noise is in every error. The picture has the held-out lighting with the median error.

    python experiments/figure_09_subsurface.py [--scene statue] [--scenario behind] [--texels 512] [--rays 512]
        [--gather 128] [--lightings 128] [--streamed 1024] [--basis 16] [--data DIR]
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from _frames import PUBLISHED, Row, arguments, draw, flip_of, lit, median_lighting, table
from settings import displayed

import prt_bench as prt
from prt_bench.metrics import negative_share, relative_rmse
from prt_bench.runtime.runtime import Runtime

SIZE = (384, 384)
GOAL = 300.0
"""Seconds of the bake on 2 cores."""
DRAWN = ("as published", "in gamma space", "reduced-rank")


def main() -> None:
    settings = arguments(
        __doc__, "figure_09.webp", scene="statue", scenario="behind", texels=512, rays=512, gather=128, lightings=128,
        streamed=1024, basis=16,
    ).parse_args()  # fmt: skip
    own = {"mean": False, "transfer": "per-channel", "normalise": "indirect"}
    with TemporaryDirectory() as folder:
        ds = baked(settings, settings.data or Path(folder))
        test, stone = ds.split("test"), ds.scene.translucent_at(ds.points.face)
        methods = {
            "as published": prt.method("svd-ridge", basis=settings.basis, **PUBLISHED),
            "in gamma space": prt.method("svd-ridge", basis=settings.basis, gamma=2.2, **PUBLISHED),
            "per channel": prt.method("svd-ridge", basis=settings.basis, **own),
            "per channel, gamma space": prt.method("svd-ridge", basis=settings.basis, gamma=2.2, **own),
            "operator-ridge": prt.method("operator-ridge", basis=settings.basis),
            "reduced-rank": prt.method("reduced-rank", basis=settings.basis),
        }
        lines, rows, runtime, index = [], [], Runtime(ds, SIZE), None
        for name, method in methods.items():
            started = time.perf_counter()
            asset = method.fit(ds.split("train")).export(Path(folder) / name.replace(" ", "-").replace(",", ""))
            seconds = time.perf_counter() - started
            index = median_lighting(asset, test) if index is None else index
            found = np.asarray(asset.predict(test))
            shown, captions = lit(runtime, test, index, asset)
            lines.append((
                name, *errors(found, test.indirect), *errors(found[:, stone], test.indirect[:, stone]),
                f"{negative_share(found):.1%}", flip_of(captions), f"{sum(asset.bytes.values()) / 1e6:.1f}",
                f"{seconds:.1f}",
            ))  # fmt: skip
            if name in DRAWN:
                rows.append(Row(name, shown, captions))
        table(("transfer", "error", "displayed", "stone", "displayed", "below zero", "FLIP", "MB", "fit s"), lines)
        print(f"\nnoise floor {test.noise_floor:.3f}; drawn: held-out lighting {index}")
        draw(settings.out, rows)


def baked(settings: argparse.Namespace, folder: Path) -> prt.LightingDataset:
    """The bake, with what it cost."""
    scene = prt.load_scene(settings.scene)
    started, busy = time.perf_counter(), time.process_time()
    ds = prt.bake(
        scene, settings.scenario, settings.lightings, settings.texels, settings.rays, gather_texels=settings.gather,
        streamed=settings.streamed, out=folder,
    )  # fmt: skip
    seconds, busy = time.perf_counter() - started, time.process_time() - busy
    spent, actual = ds.metadata["seconds"], ds.metadata["actual"]
    walks = ds.transport.walks
    assert walks is not None
    print(
        f"{len(ds.points)} receivers, {len(walks.receivers.rows)} of them translucent; {settings.rays} rays and walks"
    )
    print(
        f"bake {seconds:.0f} s: rays and walks {spent['trace']:.0f} s, light {spent['light']:.0f} s; {busy:.0f} s of processors"
    )
    print(f"predicted {ds.metadata['predicted']['seconds']:.0f} s; goal {GOAL:.0f} s on 2 cores")
    print(f"{actual['gather_rays'] / 1e6:.0f} M gather rays, {actual['shadow_rays'] / 1e6:.0f} M shadow rays,"
          f" {actual['disk_bytes'] / 1e6:.0f} MB on disk, {actual['memory_bytes'] / 1e6:.0f} MB in memory")  # fmt: skip
    for name, fates in walks.fates.items():
        total = np.sum([np.array(values) for values in fates.values()], axis=0)
        shares = (f"{fate} {np.round(100 * np.array(values) / total, 1)} %" for fate, values in fates.items())
        print(f"walks in {name}: " + ", ".join(shares))
    return ds


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float | None, float | None]:
    """Relative RMSE, of light and of what a screen shows of it."""
    return relative_rmse(found, truth), relative_rmse(displayed(found), displayed(truth))


if __name__ == "__main__":
    main()
