"""The README's picture and table from a finished quickstart run: rendered frames above, error against frame time below.

    python experiments/quickstart_figure.py [--run runs/quickstart] [--out experiments/figures/quickstart.png]

Everything comes from the run's records and pictures. The table is printed as Markdown.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter

from prt_bench import records
from prt_bench.images import exposure_for, tone_map
from prt_bench.records import Record
from prt_bench.report.pictures import read_picture

SHOWN = ("svd-ridge b64", "operator-ridge b64", "reduced-rank b64")
COLOURS = {"svd-ridge": "#D55E00", "operator-ridge": "#0072B2", "reduced-rank": "#009E73", "projection": "#999999"}


def main() -> None:
    """Draw the figure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--run", type=Path, default=Path("runs/quickstart"))
    parser.add_argument("--out", type=Path, default=Path("experiments/figures/quickstart.png"))
    args = parser.parse_args()
    rows = [row for row in records.read(args.run / "records.jsonl") if row.split == "test"]
    scenes = sorted({row.scene for row in rows})
    figure = plt.figure(figsize=(13, 3.0 * len(scenes) + 3.6), dpi=110, layout="constrained")
    pictures, plots = figure.subfigures(2, 1, height_ratios=(2.6 * len(scenes), 3.4))
    grid = pictures.subplots(len(scenes), 1 + len(SHOWN), squeeze=False)
    for line, scene in zip(grid, scenes, strict=True):
        _frames(line, [row for row in rows if row.scene == scene], args.run)
    for axes, scene in zip(plots.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        _frontier(axes, [row for row in rows if row.scene == scene])
    args.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out)
    print(_table(rows))


def _frames(line: list[Axes], rows: list[Record], run: Path) -> None:
    by_label = {row.label: row for row in rows}
    reference = read_picture(run / by_label[SHOWN[0]].pictures["reference"])
    exposure = exposure_for(reference)
    images = {"reference": reference}
    images |= {label: read_picture(run / by_label[label].pictures["prediction"]) for label in SHOWN}
    for axes, (label, image) in zip(line, images.items(), strict=True):
        axes.imshow(tone_map(image, exposure))
        error = by_label[label].errors.relative_rmse if label in by_label and label != "reference" else None
        axes.set_title(label if error is None else f"{label}: {error:.1%}", fontsize=10)
        axes.set_axis_off()


def _frontier(axes: Axes, rows: list[Record]) -> None:
    marks = []
    for row in rows:
        gl = [timing for timing in row.timings if timing.api == "gl"]
        if not gl or row.method not in COLOURS or "float16" in row.label:
            continue
        frame, error = gl[0].stages["frame"].median, row.errors.relative_rmse
        filled = "per-channel" not in row.label
        axes.scatter(
            frame, error, color=COLOURS[row.method] if filled else "none", edgecolors=COLOURS[row.method], s=36
        )
        marks.append((error, frame, row.label))
    axes.axhline(rows[0].errors.noise_floor or 0.0, color="#777777", linestyle="--", linewidth=1)
    axes.set(yscale="log", xlabel="frame [ms]", title=f"{rows[0].scene}, {rows[0].scenario} lights")
    axes.set_ylabel("relative RMSE (dashed: noise floor)")
    axes.yaxis.set_major_locator(FixedLocator([0.05, 0.1, 0.2, 0.3, 0.5]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    left, right = axes.get_xlim()
    axes.set_xlim(left - 0.08 * (right - left), right + 0.32 * (right - left))
    axes.grid(alpha=0.25)
    _labels(axes, sorted(marks))


def _labels(axes: Axes, marks: list[tuple[float, float, str]]) -> None:
    """Names beside the marks, upwards, each at least a line above any other that starts nearby; long ones in two lines."""
    placed: list[tuple[float, float]] = []
    for error, frame, label in marks:
        x, y = axes.transData.transform((frame, error)) * 72.0 / axes.figure.dpi
        text = label.replace(" mean=False", "\nmean=False")
        height = y - 3.0
        for other, top in placed:
            if abs(other - x) < 40.0:
                height = max(height, top + 1.0)
        placed.append((x, height + 9.0 * (1 + text.count("\n"))))
        axes.annotate(
            text, (frame, error), xytext=(7, height - y), textcoords="offset points", fontsize=7, linespacing=1.0,
            va="bottom",
        )  # fmt: skip


def _table(rows: list[Record]) -> str:
    lines = [
        "| scene | method | rel. RMSE | projection | FLIP | frame ms | no indirect ms | runtime MB | bake s | fit s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda row: (row.scene, row.errors.relative_rmse or 0.0)):
        gl = [timing for timing in row.timings if timing.api == "gl"]
        frame, baseline = (gl[0].stages["frame"], gl[0].baseline) if gl else (None, None)
        cells = (
            row.scene, row.label, _figure(row.errors.relative_rmse, 3), _figure(row.errors.projection, 3),
            _figure(row.errors.flip, 3), _figure(frame and frame.median, 1), _figure(baseline and baseline.median, 1),
            _figure(row.bytes["runtime"] / 1e6 if "runtime" in row.bytes else None, 2),
            _figure(row.seconds["bake"], 1), _figure(row.seconds["fit"], 2),
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _figure(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    main()
