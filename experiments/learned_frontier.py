"""Learned models against the closed form at equal bytes, equal milliseconds and equal seconds of fitting.

Width, depth, encoding and basis size of `mlp-coefficients` and `mlp-decoder`, and `linear-finetuned`, beside `reduced-rank`
of several sizes: relative RMSE on held-out lightings in scenario and out of it, mean and range over seeds of the training;
bytes of the asset; milliseconds of a frame in the runtime; seconds of the fit. Frames are also predicted from counts of
multiplications and bytes (`prt_bench/learned/cost.py`), whose weights are fitted to every other row and tried on the rest.

    python experiments/learned_frontier.py [--scene cornell] [--scenario point] [--texels 64] [--seeds 3] [--data DIR]

Writes learned_frontier.json and .md to --out, and a picture beside the other figures.
"""

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import nnls

import prt_bench as prt
from prt_bench.assets import RuntimeAsset
from prt_bench.evaluate import errors
from prt_bench.learned.cost import cost_of
from prt_bench.learned.start import start_from
from prt_bench.methods.mlp_decoder import MlpDecoder
from prt_bench.models import Model
from prt_bench.runtime import Runtime
from prt_bench.runtime.timing import time_assets
from prt_bench.store import data_folder

CLOSED = (4, 8, 16, 64, 96)
RESIDUAL = ((16, 128, 2), (64, 64, 1), (64, 64, 2), (64, 128, 2))
DECODERS = ((16, 32, "frequency"), (16, 64, "none"), (16, 64, "frequency"), (16, 64, "grid"))
OOD = {"point": ("spot", "directional"), "spot": ("point", "directional")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="cornell")
    parser.add_argument("--scenario", choices=OOD, default="point")
    parser.add_argument("--texels", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=MlpDecoder.steps, help="batches that fields are trained with")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="of the timed frames")
    parser.add_argument("--data", type=Path, default=None, help="where bakes are kept")
    parser.add_argument("--out", type=Path, default=Path("runs/learned_frontier"))
    parser.add_argument("--figure", type=Path, default=Path("experiments/figures/learned_frontier.webp"))
    settings = parser.parse_args()
    warnings.simplefilter("ignore")  # functions that small scenes leave empty
    ds = prt.bake(
        prt.load_scene(settings.scene), settings.scenario, 128, settings.texels, 256, measurements=256, seed=0,
        out=settings.data or data_folder(), ood=OOD[settings.scenario], streamed=2048,
    )  # fmt: skip
    rows, assets = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for label, models in fits(ds.split("train"), settings.seeds, settings.steps):
            rows.append(row_of(label, models, ds))
            assets[label] = models[0][0].export(Path(folder) / str(len(rows)))
            rows[-1]["bytes"] = sum(assets[label].bytes.values())
            print(json.dumps(rows[-1]), flush=True)
        add_frames(rows, assets, ds, tuple(settings.size))
    settings.out.mkdir(parents=True, exist_ok=True)
    (settings.out / "learned_frontier.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    text = "\n".join(table(rows)) + "\n"
    (settings.out / "learned_frontier.md").write_text(text, encoding="utf-8")
    print(text)
    draw(settings.figure, rows)


def fits(train: prt.LightingDataset, seeds: int, steps: int) -> Iterator[tuple[str, list[tuple[Model, float]]]]:
    """Each row's label, and its model and seconds for every seed; rows of one basis share the seconds of their start."""
    for basis in CLOSED:
        method = prt.method("reduced-rank", basis=basis)
        yield method.label, [timed(lambda method=method: method.fit(train))]
    starts = {}
    for basis in sorted({each[0] for each in (*RESIDUAL, *DECODERS)}):
        starts[basis] = timed(lambda basis=basis: start_from(train, basis, "learned_frontier"))
    tuned = prt.method("linear-finetuned", basis=16)
    yield tuned.label, [timed(lambda: tuned.fit(train, jax.random.key(0)))]
    for basis, width, depth in RESIDUAL:
        method = prt.method("mlp-coefficients", basis=basis, width=width, depth=depth)
        start, spent = starts[basis]
        found = [timed(lambda m=method, s=start, k=seed: m.train_from(s, jax.random.key(k))) for seed in range(seeds)]
        yield f"mlp-coefficients b{basis} {width}×{depth}", [(model, seconds + spent) for model, seconds in found]
    for basis, width, encoding in DECODERS:
        method = prt.method("mlp-decoder", basis=basis, width=width, encoding=encoding, steps=steps)
        start, spent = starts[basis]
        found = [
            timed(lambda m=method, s=start, k=seed: m.train_from(train, s, jax.random.key(k))) for seed in range(seeds)
        ]
        yield f"mlp-decoder b{basis} {width}×2 {encoding}", [(model, seconds + spent) for model, seconds in found]


def timed(work) -> tuple:
    """A result and its seconds."""
    started = time.perf_counter()
    return jax.block_until_ready(work()), time.perf_counter() - started


def row_of(label: str, models: list[tuple[Model, float]], ds: prt.LightingDataset) -> dict:
    """Mean and range of the errors over seeds."""
    row = {"label": label, "seeds": len(models), "fit_seconds": float(np.median([seconds for _, seconds in models]))}
    for split in (name for name in ds.splits if name != "train"):
        found = [errors(model, ds.split(split)) for model, _ in models]
        values = [each.relative_rmse for each in found]
        row[split] = [float(np.mean(values)), float(np.min(values)), float(np.max(values))]
        row[f"{split} projection"] = float(np.mean([each.projection for each in found]))
    return row


def add_frames(
    rows: list[dict], assets: dict[str, RuntimeAsset], ds: prt.LightingDataset, size: tuple[int, int]
) -> None:
    """Milliseconds of a frame and its stages, all rows interleaved; and what counts of work say, from every other row."""
    runtime = Runtime(ds, size, 512)
    timings = time_assets(
        {label: runtime.load(asset) for label, asset in assets.items()}, ds.split("test").lightings[0]
    )
    counts = []
    for row in rows:
        stages = timings[row["label"]][0].stages
        row |= {name: stages[name].median for name in ("transfer", "draw", "frame")}
        cost = cost_of(assets[row["label"]])
        row["cost"] = cost._asdict()
        pixels = size[0] * size[1]
        counts.append([1.0, cost.transfer_operations, pixels * cost.fragment_operations, pixels * cost.fragment_bytes])
    known, frames = np.array(counts), np.array([row["frame"] for row in rows])
    fitted = slice(None, None, 2)  # relative errors, so that a slow row rules nothing
    weights, _ = nnls(known[fitted] / frames[fitted, None], np.ones(len(frames[fitted])))
    for row, predicted, number in zip(rows, known @ weights, range(len(rows)), strict=True):
        row |= {"predicted_frame": float(predicted), "predicted_from_others": number % 2 == 1}


def table(rows: list[dict]) -> list[str]:
    """Markdown: one line per row."""
    splits = [name for name in rows[0] if name == "test" or (name.startswith("ood-") and "projection" not in name)]
    head = ["row", *splits, "kB", "fit s", "transfer ms", "draw ms", "frame ms", "predicted ms"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [row["label"]]
        for split in splits:
            mean, low, high = row[split]
            cells.append(f"{mean:.3f}" + (f" ({low:.3f}–{high:.3f})" if row["seeds"] > 1 else ""))
        cells += [f"{row['bytes'] / 1e3:.0f}", f"{row['fit_seconds']:.0f}"]
        cells += [f"{row[name]:.2f}" for name in ("transfer", "draw", "frame")]
        cells.append(f"{row['predicted_frame']:.2f}" + ("" if row["predicted_from_others"] else " (fitted)"))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def draw(path: Path, rows: list[dict]) -> None:
    """Error against bytes, frame time and fit time, in scenario and out of it."""
    splits = [name for name in rows[0] if name == "test" or (name.startswith("ood-") and "projection" not in name)]
    costs = {"bytes": "bytes of the asset", "frame": "ms of a frame", "fit_seconds": "seconds of the fit"}
    figure, grid = plt.subplots(len(splits), 3, figsize=(11, 3 * len(splits)), sharey="row", layout="constrained")
    kinds = {"reduced-rank": "o-", "linear-finetuned": "d", "mlp-coefficients": "s", "mlp-decoder": "^"}
    for line, split in zip(grid, splits, strict=True):
        for axes, (cost, title) in zip(line, costs.items(), strict=True):
            for kind, style in kinds.items():
                chosen = [row for row in rows if row["label"].startswith(kind)]
                mean, low, high = np.array([row[split] for row in chosen]).T
                x = [row[cost] for row in chosen]
                axes.plot(x, mean, style if cost != "fit_seconds" else style[0], markersize=5, label=kind)
                axes.vlines(x, low, high, color=axes.lines[-1].get_color(), linewidth=1.5)
            axes.set(xscale="log", yscale="log", xlabel=title)
        line[0].set_ylabel(f"{split}: relative RMSE")
    grid[0, 0].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 88} if path.suffix == ".webp" else None)
    print(f"picture: {path}")


if __name__ == "__main__":
    main()
