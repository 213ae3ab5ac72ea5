"""Error against basis size, beside the projection error (Figures 13 and 14 of Belcour et al. 2022), on our scenes.

The paper's settings are the row `published`: mean, mono-channel, light over the norm of its measured values, ridge 1e-3; its
error on the lightings it was fitted to is drawn too. `reduced-rank` is the best linear map of the same size and cost.
Errors are relative RMSE on held-out lightings; the paper's are RMSE of display values, so shapes compare, not heights.

    python experiments/figure_14_basis_size.py [--scene cornell] [--scenario point] [--data DIR]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt

import prt_bench as prt
from prt_bench.evaluate import errors
from prt_bench.store import data_folder

SIZES = (4, 8, 16, 32, 64)
PUBLISHED = {"normalise": "measured", "ridge": 1e-3}
COLOURS = {
    "published": "#D55E00",
    "published, lightings it was fitted to": "#E69F00",
    "reduced-rank": "#0072B2",
    "projection": "#666666",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="cornell")
    parser.add_argument("--scenario", default="point")
    parser.add_argument("--streamed", type=int, default=2048)
    parser.add_argument("--data", type=Path, default=None, help="where bakes are kept")
    parser.add_argument("--out", type=Path, default=Path("experiments/figures/figure_14.png"))
    settings = parser.parse_args()
    ds = prt.bake(
        prt.load_scene(settings.scene), settings.scenario, 128, 128, 256, measurements=256, seed=0,
        out=settings.data or data_folder(), streamed=settings.streamed,
    )  # fmt: skip
    train, test = ds.split("train"), ds.split("test")
    curves: dict[str, list[float]] = {name: [] for name in COLOURS}
    print("| basis | " + " | ".join(curves) + " |\n|" + "---|" * (len(curves) + 1))
    for size in SIZES:
        published = prt.method("svd-ridge", basis=size, **PUBLISHED).fit(train)
        found = errors(published, test)
        reduced = errors(prt.method("reduced-rank", basis=size).fit(train), test)
        values = (found.relative_rmse, errors(published, train).relative_rmse, reduced.relative_rmse, found.projection)
        for curve, value in zip(curves.values(), values, strict=True):
            curve.append(float(value))
        print(f"| {size} | " + " | ".join(f"{value:.3f}" for value in values) + " |", flush=True)

    figure, axes = plt.subplots(figsize=(6.5, 3.8), dpi=120, layout="constrained")
    for name, curve in curves.items():
        axes.plot(SIZES, curve, "o-" if name != "projection" else "s--", color=COLOURS[name], label=name, markersize=4)
    axes.axhline(test.noise_floor, color="#999999", linewidth=0.8)
    axes.text(SIZES[-1], 1.03 * test.noise_floor, "noise floor", ha="right", va="bottom", color="#666666", fontsize=8)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xticks(SIZES, [str(size) for size in SIZES])
    ticks = (0.05, 0.1, 0.2, 0.4, 0.8)
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set(xlabel="basis functions", ylabel=f"relative RMSE, {settings.scene}, {settings.scenario} lights")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    settings.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(settings.out)


if __name__ == "__main__":
    main()
