"""Hair end to end: a bake of 10,000 strands with 128 lightings, a fit, and frames with direct and transferred indirect light.

Prints seconds against the goal of 10 minutes on 2 cores, predicted against actual, what became of the paths, errors and bytes,
and leaves a picture: direct light, indirect light by `operator-ridge`, both, and both with the baked indirect light. Belcour et
al. 2022 bake a hairball of 140,000 strands: `--strands 140000` has as many.

    python experiments/hair.py [--out DIR] [--strands N] [--lightings N] [--texels N] [--rays N] [--picture FILE]
"""

import argparse
import time
from pathlib import Path

import numpy as np
from _frames import strand_texels, table
from PIL import Image

import prt_bench as prt
from data_gen.scenes import hairball
from prt_bench.assets import RuntimeAsset
from prt_bench.runtime import Runtime

GOAL = 600.0
"""Seconds of a bake of the standard scene with 128 lightings on 2 cores."""
BASIS = 16
METHODS = ("svd-ridge", "operator-ridge")
SHOWN, FINER = (480, 360), 3
"""Size of a frame in the picture, and samples along a side of its pixels: strands are narrower than those."""


def main() -> None:
    """Bake, fit, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/hair"))
    parser.add_argument(
        "--strands", type=int, default=0, help="a hairball of so many strands, instead of the scene 'hair'"
    )
    parser.add_argument("--lightings", type=int, default=128)
    parser.add_argument("--texels", type=int, default=0, help="side of the lightmap; by default what the strands need")
    parser.add_argument("--rays", type=int, default=64)
    parser.add_argument("--picture", type=Path, default=None, help="by default in the folder of --out")
    chosen = parser.parse_args()
    scene = hairball.build(chosen.strands) if chosen.strands else prt.load_scene("hair")
    assert scene.strands is not None
    texels = chosen.texels or strand_texels(len(scene.strands))
    settings = {"scenario": "spot", "lightings": chosen.lightings, "texels": texels, "rays": chosen.rays}
    print(prt.plan(scene, **settings).table())
    ds = prt.bake(scene, **settings, out=chosen.out)
    spent, walks = ds.metadata["seconds"], ds.transport.walks
    assert walks is not None
    print(
        f"{len(scene.strands)} strands, {len(ds.points)} texels with {chosen.rays} paths, {len(ds.all_lightings)} lightings"
    )
    print(f"bake: {sum(spent.values()):.0f} s (rays {spent['trace']:.0f} s, light {spent['light']:.0f} s; predicted"
          f" {ds.metadata['predicted']['seconds']:.0f} s); goal {GOAL:.0f} s for 10,000 strands")  # fmt: skip
    actual = ds.metadata["actual"]
    print(f"{actual['gather_rays'] / 1e6:.0f} M gather rays, {actual['shadow_rays'] / 1e6:.0f} M shadow rays,"
          f" {actual['disk_bytes'] / 1e6:.0f} MB on disk, {actual['memory_bytes'] / 1e6:.0f} MB in memory")  # fmt: skip
    counts = {name: np.array(values) for name, values in walks.fates["hair"].items()}
    total = sum(counts.values())
    print("paths: " + ", ".join(f"{name} {np.round(100 * values / total, 1)} %" for name, values in counts.items()))
    print(f"noise floor {ds.split('test').noise_floor:.3f}, {ds.metadata['bounces']} bounces")

    rows, assets = [], {}
    for name in METHODS:
        started = time.perf_counter()
        model = prt.method(name, basis=BASIS).fit(ds.split("train"))
        fitted = time.perf_counter() - started
        assets[name] = model.export(chosen.out / name)
        errors = prt.evaluate(assets[name], ds.split("test")).errors
        assert errors is not None
        rows.append((name, errors.relative_rmse, errors.total, sum(assets[name].bytes.values()) / 1e6, fitted))
    table(("method", "error", "with direct light", "MB", "fit s"), rows)
    draw(ds, assets[METHODS[-1]], chosen.picture or chosen.out / f"{scene.name}.png")


def draw(ds: prt.LightingDataset, asset: RuntimeAsset, path: Path) -> None:
    """Direct light, an asset's indirect light, both, and both as baked, each pixel the mean of several."""
    runtime = Runtime(ds, size=(SHOWN[0] * FINER, SHOWN[1] * FINER), shadow_resolution=4096)
    lighting, baked = brightest(ds)
    loaded, reference = runtime.load(asset), runtime.lightmap(baked)
    frame = runtime.frame(lighting, reference)
    exposure = -float(np.log2(np.quantile(frame[frame.max(axis=2) > 0], 0.9)))
    parts = ((None, True), (loaded, False), (loaded, True), (reference, True))
    frames = [
        np.asarray(Image.fromarray(runtime.picture(lighting, light, direct, exposure)).reduce(FINER))
        for light, direct in parts
    ]
    Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in (frames[:2], frames[2:])])).save(
        path, quality=88
    )
    print(f"\npicture: {path} (on {runtime.device})")


def brightest(ds: prt.LightingDataset) -> tuple[prt.Lighting, np.ndarray]:
    """The held-out lighting that lights most of the texels, and its indirect light."""
    test = ds.split("test")
    spread = np.median(test.indirect, axis=(1, 2))
    chosen = int(np.argmax(spread))
    return test.lightings[chosen], test.indirect[chosen]


if __name__ == "__main__":
    main()
