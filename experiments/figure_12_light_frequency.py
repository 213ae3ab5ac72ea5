"""Classical PRT restricts the light's frequency (Figure 12 of Belcour et al. 2022), on our scenes.

Under environment maps and directional lights, on the same held-out lightings: `sh-texture` of several orders, once with all
light from its transfer vectors, as its paper has it, and once with indirect light alone beside exact direct light; and
methods that measure direct light in the scene instead of projecting it. Prints relative RMSE of the indirect light, and of all
light relative to all light: where a method leaves direct light to shadow maps, that is exact here.

Draws one directional light of each scene: of the held-out ones that fall at least 45° from above, which the camera sees the
lit side of, the one whose error of all light is the median of the middle order's.

    python experiments/figure_12_light_frequency.py [--scenes suzanne room] [--scenarios environment directional] [--data DIR]
"""

from collections.abc import Mapping
from tempfile import TemporaryDirectory

import numpy as np
from _frames import SIZE, Row, arguments, bake, draw, ship, table

import prt_bench as prt
from prt_bench.assets import RuntimeAsset
from prt_bench.evaluate import errors
from prt_bench.images import exposure_for, tone_map
from prt_bench.methods.base import Method
from prt_bench.metrics import flip, relative_norm
from prt_bench.runtime.runtime import Runtime

DRAWN = "directional"


def main() -> None:
    settings = arguments(
        __doc__,
        "figure_12.webp",
        scenes=["suzanne", "room"],
        scenarios=["environment", DRAWN],
        orders=[3, 5, 8],
        basis=[16, 64],
    ).parse_args()
    methods = compared(settings.orders, settings.basis)
    middle = f"sh-texture, order {settings.orders[len(settings.orders) // 2]}"
    shown = (*(f"sh-texture, order {order}" for order in settings.orders), f"operator-ridge, {settings.basis[-1]}")
    lines, rows = [], []
    for scene in settings.scenes:
        for scenario in settings.scenarios:
            ds = bake(scene, scenario, settings.data)
            test = ds.split("test")
            with TemporaryDirectory() as folder:
                assets = ship(methods, ds.split("train"), folder)
                for label, asset in assets.items():
                    found = errors(None, test, asset)
                    alone = None if asset.includes_direct else found.relative_rmse
                    lines.append((scene, scenario, label, alone, found.total, found.negative_share))
                if scenario == DRAWN:
                    rows.append(frames_of(ds, {label: assets[label] for label in shown}, middle))
            print(f"{scene}, {scenario}: noise floor {test.noise_floor:.3f} of the indirect light", flush=True)
    table(("scene", "scenario", "method", "indirect light", "all light", "below zero"), lines)
    if rows:
        draw(settings.out, rows)


def compared(orders: list[int], sizes: list[int]) -> dict[str, Method]:
    """Methods by label; a number after the linear ones is that of their basis functions."""
    methods = {f"sh-texture, order {order}": prt.method("sh-texture", order=order) for order in orders}
    methods |= {
        f"sh-texture indirect, order {order}": prt.method("sh-texture", order=order, light="indirect")
        for order in orders
    }
    for size in sizes:
        methods[f"svd-ridge, {size}"] = prt.method("svd-ridge", basis=size, mean=False, transfer="per-channel")
        methods[f"operator-ridge, {size}"] = prt.method("operator-ridge", basis=size)
    return methods


def frames_of(ds: prt.LightingDataset, assets: Mapping[str, RuntimeAsset], by: str) -> Row:
    """The reference and each asset under the light from above with the median error of the asset `by`; captions: all light."""
    test = ds.split("test")
    found = {label: error_of_all(asset, test) for label, asset in assets.items()}
    downward = np.array([np.asarray(vars(lighting.lights[0])["direction"])[1] for lighting in test.lightings])
    above = np.flatnonzero(downward < -np.sqrt(0.5))
    index = int(above[np.argsort(found[by][above])[len(above) // 2]])
    runtime, lighting = Runtime(ds, SIZE), test.lightings[index]
    drawn = {"reference": runtime.frame(lighting, runtime.lightmap(test.indirect[index]))}
    exposure = exposure_for(drawn["reference"])
    truth, captions = tone_map(drawn["reference"], exposure) / 255.0, {}
    for label, asset in assets.items():
        drawn[label] = runtime.frame(lighting, runtime.load(asset))
        score = flip(tone_map(drawn[label], exposure) / 255.0, truth)
        captions[label] = f"all light {found[label][index]:.1%}, FLIP {score:.3f}"
    return Row(ds.scene.name, drawn, captions)


def error_of_all(asset: RuntimeAsset, ds: prt.LightingDataset) -> np.ndarray:
    """‖error‖ / ‖all light‖ of each lighting; direct light is exact where the asset leaves it to shadow maps."""
    whole = ds.direct + ds.indirect
    light = asset.predict(ds) if asset.includes_direct else asset.predict(ds) + ds.direct
    return relative_norm(light - whole, whole)


if __name__ == "__main__":
    main()
