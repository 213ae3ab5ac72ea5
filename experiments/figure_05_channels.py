"""Mono- against multi-channel transfer (Figure 5 of Belcour et al. 2022): what becomes of light colours never fitted.

`svd-ridge` with one matrix for all channels (mono-channel, the paper's choice), one matrix per channel, and all channels
coupled in one vector (multi-channel). Each is fitted under the scenario's mildly coloured lights and under the same lights in
white, and tested on held-out lights as they come and in saturated red, green and blue. All else is as published: mean, light
over the norm of its measured values, ridge 1e-3. Prints relative RMSE; draws a held-out light as it comes, the same light
saturated, and the saturated light for the models that were fitted under white.

    python experiments/figure_05_channels.py [--scene cornell] [--scenario point] [--basis 64] [--data DIR]
"""

from dataclasses import replace
from tempfile import TemporaryDirectory

import numpy as np
from _frames import PUBLISHED, SIZE, Row, arguments, bake, draw, frames, median_lighting, ship, table
from settings import SATURATED

import prt_bench as prt
from prt_bench.metrics import relative_rmse
from prt_bench.runtime.runtime import Runtime

TRANSFERS = {"mono-channel": "shared", "matrix per channel": "per-channel", "multi-channel": "coupled"}


def main() -> None:
    settings = arguments(__doc__, "figure_05.webp", scene="cornell", scenario="point", basis=64).parse_args()
    ds = bake(settings.scene, settings.scenario, settings.data)
    white, saturated = recoloured(ds, np.ones((1, 3))), recoloured(ds, SATURATED)
    tests = {"as they come": ds.split("test"), "saturated": saturated.split("test")}
    methods = {
        name: prt.method("svd-ridge", basis=settings.basis, transfer=transfer, **PUBLISHED)
        for name, transfer in TRANSFERS.items()
    }
    with TemporaryDirectory() as folder:
        assets = {
            "coloured": ship(methods, ds.split("train"), f"{folder}/coloured"),
            "white": ship(methods, white.split("train"), f"{folder}/white"),
        }
        lines = [
            (name, *(error(fitted[name], test) for fitted in assets.values() for test in tests.values()))
            for name in methods
        ]
        table(("transfer", *(f"{fitted} → {test}" for fitted in assets for test in tests)), lines)
        runtime, index = Runtime(ds, SIZE), median_lighting(assets["coloured"]["mono-channel"], tests["as they come"])
        print(f"\nfitted under → tested under; drawn: held-out lighting {index}")
        rows = [
            Row(label, *frames(runtime, tests[test], index, assets[fitted]))
            for label, fitted, test in (
                ("fitted under coloured lights", "coloured", "as they come"),
                ("coloured → saturated", "coloured", "saturated"),
                ("white → saturated", "white", "saturated"),
            )
        ]
    draw(settings.out, rows)


def error(asset: prt.assets.RuntimeAsset, test: prt.LightingDataset) -> float:
    """Relative RMSE of an asset on a split."""
    return relative_rmse(np.asarray(asset.predict(test)), test.indirect)


def recoloured(ds: prt.LightingDataset, colours: np.ndarray) -> prt.LightingDataset:
    """The same lights in other colours of the same mean, in turn: light is linear in each channel, so nothing is traced."""
    lights = [lighting.lights[0] for lighting in ds.all_lightings]
    own = np.array([vars(light)["intensity"] for light in lights])
    wanted = np.resize(colours, own.shape) * own.mean(axis=1, keepdims=True)
    factor = (wanted / own)[:, None]
    arrays = {name: np.asarray(ds.arrays[name][...]) * factor for name in ("measured", "indirect")}
    lightings = [prt.Lighting([replace(light, intensity=tuple(w))]) for light, w in zip(lights, wanted, strict=True)]
    return replace(ds, all_lightings=tuple(lightings), arrays=arrays)


if __name__ == "__main__":
    main()
