"""A frame of the Cornell box: direct, our indirect, their sum, reference (Figure 7 of Belcour et al. 2022).

The paper's settings: 128 measured values, 16 basis functions, ridge 0.01, mean, mono-channel, light over the norm of its
measured values. Beside it `operator-ridge` of the same size and cost. Prints relative RMSE on all held-out lightings, the
error of projecting the reference on the same basis, and the errors of the frame that is drawn.

    python experiments/figure_07_cornell.py [--scene cornell] [--scenario point] [--data DIR]
"""

from tempfile import TemporaryDirectory

from _frames import PUBLISHED, SIZE, Row, arguments, bake, draw, lit, median_lighting, ship, table

import prt_bench as prt
from prt_bench.evaluate import errors
from prt_bench.runtime.runtime import Runtime

MEASUREMENTS, BASIS, RIDGE = 128, 16, 1e-2


def main() -> None:
    settings = arguments(__doc__, "figure_07.webp", scene="cornell", scenario="point").parse_args()
    ds = bake(settings.scene, settings.scenario, settings.data, measurements=MEASUREMENTS)
    test, runtime, lines, rows = ds.split("test"), Runtime(ds, SIZE), [], []
    methods = {
        "as published": prt.method("svd-ridge", basis=BASIS, **{**PUBLISHED, "ridge": RIDGE}),
        "operator-ridge": prt.method("operator-ridge", basis=BASIS),
    }
    with TemporaryDirectory() as folder:
        assets = ship(methods, ds.split("train"), folder)
        index = median_lighting(assets["as published"], test)
        for name, asset in assets.items():
            shown, captions = lit(runtime, test, index, asset)
            rows.append(Row(name, shown, captions))
            found = errors(None, test, asset)
            lines.append((name, found.relative_rmse, found.projection, *next(iter(captions.values())).split(", ")))
    table(("method", "rel. RMSE", "projection", "this lighting", "this frame"), lines)
    print(f"\nnoise floor {test.noise_floor:.3f}; drawn: held-out lighting {index}")
    draw(settings.out, rows)


if __name__ == "__main__":
    main()
