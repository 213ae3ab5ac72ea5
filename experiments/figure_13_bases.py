"""Frames with 4, 16 and 64 basis functions (Figure 13 of Belcour et al. 2022), on our scenes.

The first row is the published setting: mean, mono-channel, light over the norm of its measured values, ridge 1e-3, 128
lightings, 256 measured values. The second is `reduced-rank`, a linear map of the same size and cost that learns from streamed
lightings. Prints relative RMSE on all held-out lightings, the error of projecting the reference on the same basis, and FLIP
of the frame that is drawn.

    python experiments/figure_13_bases.py [--scene cornell] [--scenario point] [--data DIR]
"""

from tempfile import TemporaryDirectory

from _frames import PUBLISHED, SIZE, Row, arguments, bake, draw, frames, median_lighting, ship, table

import prt_bench as prt
from prt_bench.evaluate import errors
from prt_bench.runtime.runtime import Runtime

SIZES = (4, 16, 64)
METHODS = {"as published": ("svd-ridge", PUBLISHED), "reduced-rank": ("reduced-rank", {})}


def main() -> None:
    settings = arguments(__doc__, "figure_13.webp", scene="cornell", scenario="point", streamed=2048).parse_args()
    ds = bake(settings.scene, settings.scenario, settings.data, streamed=settings.streamed)
    train, test = ds.split("train"), ds.split("test")
    runtime, index, rows, lines = Runtime(ds, SIZE), None, [], []
    with TemporaryDirectory() as folder:
        for label, (name, options) in METHODS.items():
            methods = {f"{size} functions": prt.method(name, basis=size, **options) for size in SIZES}
            assets = ship(methods, train, f"{folder}/{name}")
            index = median_lighting(next(iter(assets.values())), test) if index is None else index
            drawn, captions = frames(runtime, test, index, assets)
            rows.append(Row(label, drawn, captions))
            for size, (title, asset) in zip(SIZES, assets.items(), strict=True):
                found = errors(None, test, asset)
                flip = captions[title].split("FLIP ")[1]
                lines.append((label, size, found.relative_rmse, found.projection, flip))
    table(("method", "functions", "rel. RMSE", "projection", "FLIP of the frame"), lines)
    print(f"\nnoise floor {test.noise_floor:.3f}; drawn: held-out lighting {index}")
    draw(settings.out, rows)


if __name__ == "__main__":
    main()
