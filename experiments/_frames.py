"""What the figure scripts share: the common bake, fitted models as the assets that ship, and their frames side by side.

Frames are drawn by the OpenGL runtime that loaded an asset, and errors are those of the same asset. A picture shows the
held-out lighting whose error is the median of the first asset's, so that none is chosen by hand.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from prt_bench.assets import RuntimeAsset
from prt_bench.images import exposure_for, tone_map
from prt_bench.methods.base import Method
from prt_bench.metrics import flip, relative_norm
from prt_bench.runtime.runtime import Runtime
from prt_bench.store import data_folder
from prt_bench.strands import TEXELS

PUBLISHED = {"normalise": "measured", "ridge": 1e-3}
"""What `svd-ridge` needs to be as published: light over the norm of its measured values; mean and mono-channel are its own."""
SIZE = (320, 320)
_SUM = "our direct + indirect"


class Row(NamedTuple):
    """One line of a picture: its label, frames in linear radiance by title, and a caption below each."""

    label: str
    frames: Mapping[str, np.ndarray]
    captions: Mapping[str, str]


def arguments(doc: str | None, figure: str | None, data: bool = True, **defaults: object) -> argparse.ArgumentParser:
    """A parser with the options of all figure scripts; `figure` names the default picture, `data` asks where bakes are."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in defaults.items():
        nargs = "+" if isinstance(value, list) else None
        kind = type(value[0] if isinstance(value, list) else value)
        parser.add_argument(f"--{name}", type=kind, nargs=nargs, default=value)
    if data:
        parser.add_argument("--data", type=Path, default=None, help="where bakes are kept")
    if figure:
        parser.add_argument("--out", type=Path, default=Path("experiments/figures") / figure)
    return parser


def bake(scene: str, scenario: str, data: Path | None, measurements: int = 256, **more: object) -> prt.LightingDataset:
    """128 lightings on 128² texels with 256 rays: the bake of every figure, found again where it was made before."""
    folder = data or data_folder()
    return prt.bake(
        prt.load_scene(scene), scenario, 128, 128, 256, measurements=measurements, seed=0, out=folder, **more
    )


def strand_texels(strands: int) -> int:
    """The side of a lightmap that holds so many strands of hair, and a third as much again for surfaces."""
    return 10 * ceil(1.25 * (TEXELS * strands) ** 0.5 / 10)


def ship(methods: Mapping[str, Method], train: prt.LightingDataset, folder: str | Path) -> dict[str, RuntimeAsset]:
    """Fit methods and export them; the assets as loaded back, by the same names."""
    return {
        name: method.fit(train).export(Path(folder) / name.replace(" ", "-").replace(",", ""))
        for name, method in methods.items()
    }


def median_lighting(asset: RuntimeAsset, test: prt.LightingDataset) -> int:
    """Which lighting of a split has the median relative error."""
    error = relative_norm(np.asarray(asset.predict(test)) - test.indirect, test.indirect)
    return int(np.argsort(error)[len(error) // 2])


def frames(
    runtime: Runtime, ds: prt.LightingDataset, index: int, assets: Mapping[str, RuntimeAsset], direct: bool = True
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Frames of the reference and of each asset under one lighting, and captions: relative error and FLIP of the frame."""
    lighting, truth = ds.lightings[index], ds.indirect[index : index + 1]
    drawn = {"reference": runtime.frame(lighting, runtime.lightmap(truth[0]), direct)}
    exposure = exposure_for(drawn["reference"])
    shown = tone_map(drawn["reference"], exposure) / 255.0
    captions = {}
    for name, asset in assets.items():
        drawn[name] = runtime.frame(lighting, runtime.load(asset), direct)
        error = relative_norm(np.asarray(asset.predict(ds))[index : index + 1] - truth, truth)[0]
        captions[name] = f"error {error:.1%}, FLIP {flip(tone_map(drawn[name], exposure) / 255.0, shown):.3f}"
    return drawn, captions


def lit(
    runtime: Runtime, ds: prt.LightingDataset, index: int, asset: RuntimeAsset
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Direct light, an asset's indirect light, their sum and the reference under one lighting; error and FLIP of the sum."""
    lighting = ds.lightings[index]
    both, captions = frames(runtime, ds, index, {_SUM: asset})
    shown = {
        "direct": runtime.frame(lighting),
        "our indirect": runtime.frame(lighting, runtime.load(asset), direct=False),
        _SUM: both[_SUM],
        "reference": both["reference"],
    }
    return shown, captions


def flip_of(captions: Mapping[str, str]) -> str:
    """FLIP in the captions of `lit`."""
    return captions[_SUM].split("FLIP ")[1]


def floors(path: Path, panels: Mapping[str, np.ndarray], height: float) -> None:
    """Pictures of a floor from above beside each other, of values from 0 to 1 as a screen shows them."""
    figure, axes = plt.subplots(1, len(panels), figsize=(4 * len(panels), height), layout="constrained")
    for axis, (title, shown) in zip(axes, panels.items(), strict=True):
        axis.imshow(shown, interpolation="nearest")
        axis.set(title=title, xticks=[], yticks=[])
        axis.set_frame_on(False)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def draw(path: Path, rows: Sequence[Row], exposed_as: Callable[[str], str] = lambda title: "reference") -> None:
    """All rows in one picture, each frame exposed as the one in its row that `exposed_as` names for its title."""
    columns = max(len(row.frames) for row in rows)
    shapes = [next(iter(row.frames.values())).shape for row in rows]
    heights = [2.2 * height / width + 0.4 for height, width, _ in shapes]
    figure, grid = plt.subplots(
        len(rows), columns, figsize=(2.35 * columns + 0.2, sum(heights) + 0.15), dpi=100, layout="constrained",
        squeeze=False, height_ratios=heights,
    )  # fmt: skip
    for number, (line, row) in enumerate(zip(grid, rows, strict=True)):
        for axes in line[len(row.frames) :]:
            axes.set_axis_off()
        for axes, (title, frame) in zip(line, row.frames.items(), strict=False):
            exposure = exposure_for(row.frames[exposed_as(title)])
            axes.imshow(tone_map(frame, exposure), interpolation="lanczos")
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            if number == 0 or row.frames.keys() != rows[0].frames.keys():
                axes.set_title(title, fontsize=9)
            axes.set_xlabel(row.captions.get(title, ""), fontsize=8)
        line[0].set_ylabel(row.label, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, pil_kwargs={"quality": 88} if path.suffix == ".webp" else None)
    print(f"\npicture: {path}")


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table; numbers with three digits."""
    for line in (head, ["---"] * len(head), *rows):
        cells = (f"{cell:.3f}" if isinstance(cell, float) else "–" if cell is None else str(cell) for cell in line)
        print("| " + " | ".join(cells) + " |", flush=True)
