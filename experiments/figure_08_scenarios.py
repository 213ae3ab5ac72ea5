"""Change of lighting scenario (Figure 8 of Belcour et al. 2022): fitted on one kind of light, tested on the others.

Every pair of scenarios of one scene: relative RMSE on the tested one's held-out lightings, and in brackets the error of the
reference projected on the same basis, which tells a basis that lacks the light from a matrix that misjudges it. `svd-ridge`
as published (mean, mono-channel, light over the norm of its measured values, ridge 1e-3), the same over the size of the
indirect light with a matrix per channel and no mean, and `operator-ridge`. Draws the matrices, and as the paper does a spot
light and a directional light for models fitted on spot lights.

    python experiments/figure_08_scenarios.py [--scene cornell] [--basis 64] [--data DIR]
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from _frames import PUBLISHED, SIZE, Row, arguments, bake, draw, frames, median_lighting, ship, table
from matplotlib.colors import LogNorm

import prt_bench as prt
from data_gen.scenarios import SCENARIOS
from prt_bench.evaluate import errors
from prt_bench.runtime.runtime import Runtime

METHODS = {
    "svd-ridge, as published": ("svd-ridge", PUBLISHED),
    "svd-ridge, per channel, no mean": ("svd-ridge", {"mean": False, "transfer": "per-channel"}),
    "operator-ridge": ("operator-ridge", {}),
}
FITTED, ALIKE, UNLIKE = "spot", "spot", "directional"


def main() -> None:
    parser = arguments(
        __doc__, "figure_08.png", scene="cornell", basis=64, scenarios=[name for name in SCENARIOS if name != "behind"]
    )
    parser.add_argument("--frames", type=Path, default=Path("experiments/figures/figure_08_frames.webp"))
    settings = parser.parse_args()
    bakes = {name: bake(settings.scene, name, settings.data) for name in settings.scenarios}
    tests = {name: ds.split("test") for name, ds in bakes.items()}
    methods = {label: prt.method(name, basis=settings.basis, **options) for label, (name, options) in METHODS.items()}
    found = {label: np.zeros((len(bakes), len(bakes))) for label in methods}
    cells: dict[str, list[list[str]]] = {label: [] for label in methods}
    with TemporaryDirectory() as folder:
        for row, (fitted, ds) in enumerate(bakes.items()):
            assets = ship(methods, ds.split("train"), f"{folder}/{fitted}")
            for label, asset in assets.items():
                figures = [errors(None, test, asset) for test in tests.values()]
                found[label][row] = [figure.relative_rmse for figure in figures]
                cells[label].append(
                    [fitted, *(f"{figure.relative_rmse:.3f} ({figure.projection:.3f})" for figure in figures)]
                )
            if fitted == FITTED and UNLIKE in tests:
                rows = frames_of(bakes[FITTED], tests, assets)
    for label, lines in cells.items():
        print(f"\n{label}: fitted on ↓, tested on →\n")
        table(("", *tests), lines)
        inside = np.eye(len(bakes), dtype=bool)
        print(
            f"\nmedian in scenario {np.median(found[label][inside]):.3f}, out of it {np.median(found[label][~inside]):.3f}"
        )
    matrices(settings.out, found, list(tests))
    if {FITTED, UNLIKE} <= tests.keys():
        draw(settings.frames, rows, lambda title: f"{title.partition(':')[0]}: reference")


def frames_of(ds: prt.LightingDataset, tests: dict[str, prt.LightingDataset], assets: dict) -> list[Row]:
    """For each method a light like those it was fitted to and one unlike them, each beside its reference."""
    runtime, rows = Runtime(ds, SIZE), []
    shown = {name: median_lighting(next(iter(assets.values())), tests[name]) for name in (ALIKE, UNLIKE)}
    for label, asset in assets.items():
        row, captions = {}, {}
        for name, index in shown.items():
            drawn, caption = frames(runtime, tests[name], index, {"ours": asset})
            row |= {f"{name} light: {title}": frame for title, frame in drawn.items()}
            captions[f"{name} light: ours"] = caption["ours"]
        rows.append(Row(label.replace(", ", ",\n", 1), row, captions))
    return rows


def matrices(path: Path, found: dict[str, np.ndarray], names: list[str]) -> None:
    """One shaded matrix for each method."""
    figure, grid = plt.subplots(1, len(found), figsize=(3.6 * len(found), 3.7), dpi=110, layout="constrained")
    for axes, (label, values) in zip(grid, found.items(), strict=True):
        axes.imshow(values, cmap="cividis", norm=LogNorm(0.05, 2.0))
        for (row, column), value in np.ndenumerate(values):
            colour = "black" if value > 0.3 else "white"
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=colour, fontsize=8)
        axes.set_xticks(range(len(names)), names, fontsize=8, rotation=30, ha="right")
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.set_title(label, fontsize=9)
        axes.set_xlabel("tested on", fontsize=8)
    grid[0].set_ylabel("fitted on", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    print(f"\npicture: {path}")


if __name__ == "__main__":
    main()
