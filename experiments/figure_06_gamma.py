"""Transfer in gamma space against linear transfer (Figure 6 of Belcour et al. 2022), on diffuse scenes and translucent bodies.

The paper shows it on subsurface scattering, as `candle` has it here; elsewhere it is indirect light between diffuse surfaces.
`svd-ridge` as published (mean, mono-channel, light over the norm of its measured values, ridge 1e-3) with gamma 1 and 2.2.
Prints relative RMSE of held-out lightmaps in linear light, the same error of max(0, y)^(1/2.2), both for translucent bodies
alone where there are any, the share of values below zero, and FLIP of the frame drawn. Frames show the indirect light alone.

    python experiments/figure_06_gamma.py [--scenes cornell suzanne candle] [--scenario point] [--basis 16] [--data DIR]
"""

from tempfile import TemporaryDirectory

import numpy as np
from _frames import PUBLISHED, SIZE, Row, arguments, bake, draw, frames, median_lighting, ship, table
from settings import displayed

import prt_bench as prt
from prt_bench.metrics import negative_share, relative_rmse
from prt_bench.runtime.runtime import Runtime

GAMMAS = {"linear": 1.0, "gamma space": 2.2}


def main() -> None:
    parser = arguments(__doc__, "figure_06.webp", scenes=["cornell", "suzanne", "candle"], scenario="point", basis=16)
    settings = parser.parse_args()
    methods = {
        name: prt.method("svd-ridge", basis=settings.basis, gamma=gamma, **PUBLISHED) for name, gamma in GAMMAS.items()
    }
    rows, lines = [], []
    for scene in settings.scenes:
        ds = bake(scene, settings.scenario, settings.data)
        test = ds.split("test")
        with TemporaryDirectory() as folder:
            assets = ship(methods, ds.split("train"), folder)
            index = median_lighting(assets["linear"], test)
            drawn, captions = frames(Runtime(ds, SIZE), test, index, assets, direct=False)
            for name, asset in assets.items():
                found = np.asarray(asset.predict(test))
                bodies = ds.scene.translucent_at(ds.points.face)
                lines.append((
                    scene, name, *_errors(found, test.indirect),
                    *(_errors(found[:, bodies], test.indirect[:, bodies]) if bodies.any() else (None, None)),
                    negative_share(found), captions[name].split("FLIP ")[1],
                ))  # fmt: skip
        rows.append(Row(f"{scene}, lighting {index}", drawn, captions))
    head = ("rel. RMSE", "as displayed", "on bodies", "as displayed", "below zero", "FLIP of the frame")
    table(("scene", "transfer", *head), lines)
    draw(settings.out, rows)


def _errors(found: np.ndarray, truth: np.ndarray) -> tuple[float | None, float | None]:
    """Relative RMSE, of light and of what a screen shows of it."""
    return relative_rmse(found, truth), relative_rmse(displayed(found), displayed(truth))


if __name__ == "__main__":
    main()
