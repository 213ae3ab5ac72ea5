"""Surfaces, a translucent body and hair under one method (Figure 1 of Belcour et al. 2022): direct, indirect, sum, reference.

Bakes `suzanne`, `statue` with lights behind it, and `hairball`, and fits `svd-ridge` with 16 functions and a matrix per
channel, on the statue in gamma space. Prints seconds of the bakes, errors of held-out indirect light and FLIP of the frames
drawn.

    python experiments/figure_01_overview.py [--texels 256] [--rays 256] [--strands 2000] [--lightings 128] [--basis 16]
        [--data DIR]
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from _frames import SIZE, Row, arguments, draw, flip_of, lit, median_lighting, strand_texels, table

import prt_bench as prt
from data_gen.scenes import hairball
from prt_bench.metrics import relative_rmse
from prt_bench.runtime.runtime import Runtime


def main() -> None:
    settings = arguments(
        __doc__, "figure_01.webp", texels=256, rays=256, strands=2000, lightings=128, basis=16, shadows=2048
    ).parse_args()
    hair_texels = strand_texels(settings.strands)
    bakes = {
        "surfaces": (prt.load_scene("suzanne"), "point", settings.texels, settings.rays, 1.0),
        "translucent": (prt.load_scene("statue"), "behind", settings.texels, settings.rays, 2.2),
        "hair": (hairball.build(settings.strands), "point", hair_texels, 64, 1.0),
    }
    rows, lines = [], []
    with TemporaryDirectory() as folder:
        for label, (scene, scenario, texels, rays, gamma) in bakes.items():
            started = time.perf_counter()
            more = {} if label == "hair" else {"gather_texels": min(128, texels)}
            ds = prt.bake(scene, scenario, settings.lightings, texels, rays, out=settings.data or Path(folder), **more)
            seconds, test = time.perf_counter() - started, ds.split("test")
            method = prt.method(
                "svd-ridge", basis=settings.basis, mean=False, transfer="per-channel", normalise="indirect", gamma=gamma
            )
            asset = method.fit(ds.split("train")).export(Path(folder) / label)
            index = median_lighting(asset, test)
            runtime = Runtime(ds, SIZE, shadow_resolution=settings.shadows)
            shown, captions = lit(runtime, test, index, asset)
            rows.append(Row(f"{label}: {scene.name}", shown, captions))
            error = relative_rmse(np.asarray(asset.predict(test)), test.indirect)
            lines.append((label, scene.name, f"{texels}²", f"{seconds:.0f}", error, flip_of(captions)))
    table(("kind", "scene", "texels", "bake s", "error", "FLIP"), lines)
    draw(settings.out, rows)


if __name__ == "__main__":
    main()
