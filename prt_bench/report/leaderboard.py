"""`leaderboard.{md,csv,json,tex}`: the ranked rows as a table to read, raw figures to compute with, LaTeX for a paper.

What is printed here rounds to three digits; `leaderboard.csv` and `leaderboard.json` keep every digit of the records.
"""

import csv
import io
import json
import os
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from prt_bench import records as record_files
from prt_bench.records import Record
from prt_bench.report.frontier import METRICS, Row
from prt_bench.report.ranking import TIE_RULE, Entry, Group, groups

MISSING = "–"


@dataclass(frozen=True)
class Column:
    """A printed column: the band it stands in, its head and unit, and its text and sort key for an entry."""

    name: str
    band: str
    head: str
    unit: str
    numeric: bool
    text: Callable[[Entry], str]
    key: Callable[[Entry], Any]


def figure(metric: str, value: float | None) -> str:
    """A value to three significant digits in its metric's unit; bytes with a decimal prefix."""
    if value is None:
        return MISSING
    if METRICS[metric].unit == "bytes":
        for prefix, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
            if value >= size:
                return f"{_three_digits(value / size)} {prefix}"
        return f"{value:.0f} B"
    return f"{value:.1f}" if METRICS[metric].unit == "dB" else _three_digits(value)


def _three_digits(value: float) -> str:
    if value == 0 or abs(value) >= 999.5:
        return f"{value:.0f}"
    return f"{value:.2e}" if abs(value) < 1e-3 else f"{value:#.3g}".removesuffix(".")


def effects(row: Row) -> str:
    """The effects that the planner switched on for the row's scene."""
    return ", ".join(row.record.dataset.get("effects") or ()) or "diffuse"


def status(row: Row) -> str:
    """The status, with its reason unless ok."""
    return row.record.status + (f": {row.record.reason}" if row.record.reason else "")


def _text(name: str, head: str, get: Callable[[Entry], str]) -> Column:
    return Column(name, "", head, "", False, get, get)


def _number(band: str, name: str, head: str | None = None) -> Column:
    metric = METRICS[name]
    unit = "" if metric.unit == "bytes" else metric.unit
    return Column(
        name, band, head or metric.label, unit, True,
        lambda entry: figure(name, metric.of(entry.row)), lambda entry: metric.of(entry.row),
    )  # fmt: skip


COLUMNS = (
    Column("rank", "", "#", "", True, lambda entry: entry.place, lambda entry: entry.rank),
    _text("label", "Method", lambda entry: entry.row.record.label),
    _number("Accuracy", "relative_rmse", "Rel. RMSE"),
    _number("Accuracy", "total", "All light"),
    _number("Accuracy", "rmse"),
    _number("Accuracy", "psnr"),
    _number("Accuracy", "flip"),
    _number("Accuracy", "ssim"),
    _number("Time [ms]", "measure_ms"),
    _number("Time [ms]", "transfer_ms"),
    _number("Time [ms]", "draw_ms"),
    _number("Time [ms]", "frame_ms"),
    _number("Time [ms]", "indirect_ms", "Indirect"),
    _number("Time [ms]", "jax_ms"),
    _number("Memory", "runtime_bytes", "Runtime"),
    _number("Memory", "asset_bytes", "Asset"),
    _number("Preparation [s]", "bake_s"),
    _number("Preparation [s]", "fit_s"),
    _text("effects", "Effects", lambda entry: effects(entry.row)),
    _text("status", "Status", lambda entry: status(entry.row)),
)


def columns(*names: str) -> tuple[Column, ...]:
    """The named columns, in the order asked for."""
    by_name = {column.name: column for column in COLUMNS}
    return tuple(by_name[name] for name in names)


def flatten(record: Record) -> dict[str, Any]:
    """Every figure and setting of a record as `a.b.c` → scalar; timings as `gl.frame.median`, lists as JSON.

    Curves and pictures stay in `records.jsonl`, and so do the planner's decisions and what they left out.
    """
    data = asdict(record)
    del data["curves"], data["pictures"]
    for name in ("plan", "skips"):
        data["dataset"].pop(name, None)
    for timing in data.pop("timings"):
        data.setdefault(timing["api"], {**timing, **timing["stages"], "stages": {}})
    return dict(_leaves(data, ""))


def _leaves(data: dict[str, Any], prefix: str) -> Iterable[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, json.dumps(value) if isinstance(value, list | tuple) else value


def to_csv(board: Sequence[Group]) -> str:
    """One line per row, all figures at full precision (shortest exact decimal); an empty cell was not measured."""
    lines = []
    for group in board:
        for entry in group.entries:
            row = entry.row
            one_machine = {**asdict(row.record), "timings": [asdict(timing) for timing in (row.gl, row.jax) if timing]}
            lines.append(
                {"rank": entry.rank, "tied": entry.tied, "device": group.device}
                | flatten(record_files.from_json(one_machine))
            )
    names = dict.fromkeys(name for line in lines for name in line)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(names), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def to_json(board: Sequence[Group]) -> str:
    """The groups with their entries, and what every metric means."""
    meaning = {
        metric.name: {
            "label": metric.label,
            "unit": metric.unit,
            "better": "higher" if metric.higher_is_better else "lower",
        }
        for metric in METRICS.values()
    }
    boards = [
        {
            **{name: getattr(group, name) for name in ("scene", "scenario", "split", "device", "noise_floor")},
            "entries": [
                {
                    "rank": entry.rank,
                    "tied": entry.tied,
                    **{
                        name: getattr(entry.row.record, name)
                        for name in ("method", "label", "role", "status", "reason")
                    },
                    "effects": entry.row.record.dataset.get("effects") or [],
                    "metrics": {metric.name: metric.of(entry.row) for metric in METRICS.values()},
                }
                for entry in group.entries
            ],
        }
        for group in board
    ]
    return json.dumps({"tie_rule": TIE_RULE, "metrics": meaning, "groups": boards}, indent=1, allow_nan=False) + "\n"


def to_markdown(board: Sequence[Group]) -> str:
    """One table per group."""
    parts = ["# Leaderboard", "", f"Ranked by relative RMSE on held-out lightings. {TIE_RULE}", ""]
    for group in board:
        parts += [
            f"## {_markdown(group.title)}",
            "",
            f"{_markdown(group.device)}. Noise floor of the reference: {figure('relative_rmse', group.noise_floor)}.",
            "",
            "| " + " | ".join(_markdown(_head(column)) for column in COLUMNS) + " |",
            "|" + "|".join("--:" if column.numeric else ":--" for column in COLUMNS) + "|",
            *(
                "| " + " | ".join(_markdown(column.text(entry)) for column in COLUMNS) + " |"
                for entry in group.entries
            ),
            "",
        ]  # fmt: skip
    return "\n".join(parts)


TEX_COLUMNS = columns(
    "rank", "label", "relative_rmse", "flip", "measure_ms", "transfer_ms", "draw_ms", "frame_ms",
    "runtime_bytes", "bake_s", "fit_s", "status",
)  # fmt: skip


def to_latex(board: Sequence[Group]) -> str:
    r"""One booktabs table per group, to `\input` into a paper. The status column gives no reasons, to stay narrow."""
    parts = [r"% \input this file; it needs \usepackage{booktabs}. Ranked by relative RMSE on held-out lightings."]
    for group in board:
        caption = f"{group.title}. {group.device}. Noise floor {figure('relative_rmse', group.noise_floor)}."
        parts += [
            r"\begin{table*}",
            r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"\caption{{{_latex(caption)}}}",
            r"\begin{tabular}{@{}" + "".join("r" if column.numeric else "l" for column in TEX_COLUMNS) + r"@{}}",
            r"\toprule",
            " & ".join(_latex(_head(column)) for column in TEX_COLUMNS) + r" \\",
            r"\midrule",
            *(
                " & ".join(
                    _latex(entry.row.record.status if column.name == "status" else column.text(entry))
                    for column in TEX_COLUMNS
                )
                + r" \\"
                for entry in group.entries
            ),
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table*}",
        ]
    return "\n".join(parts) + "\n"


def _head(column: Column) -> str:
    return f"{column.head} [{column.unit}]" if column.unit else column.head


def _markdown(text: str) -> str:
    for character in "\\`*_[]<>|#":
        text = text.replace(character, "&lt;" if character == "<" else f"\\{character}")
    return " ".join(text.split())


_LATEX = {character: f"\\{character}" for character in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}", '"': "''", "–": "--", "×": r"$\times$", "·": r"$\cdot$",
    "²": "$^2$", "µ": r"$\mu$", "λ": r"$\lambda$",
}  # fmt: skip


def _latex(text: str) -> str:
    """Escaped for any LaTeX engine: what is not ASCII and has no command here loses its accents or becomes `?`."""
    shown = []
    for character in " ".join(text.split()):
        if character in _LATEX or (character.isascii() and character.isprintable()):
            shown.append(_LATEX.get(character, character))
        else:
            plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
            shown.append("".join(_LATEX.get(letter, letter) for letter in plain) or "?")
    # A leading bracket would be read as the optional argument of the line break before it.
    joined = "".join(shown)
    return f"{{}}{joined}" if joined.startswith(("[", "*")) else joined


WRITERS: dict[str, Callable[[Sequence[Group]], str]] = {
    "md": to_markdown,
    "csv": to_csv,
    "json": to_json,
    "tex": to_latex,
}


def write_leaderboard(run_dir: Path) -> list[Path]:
    """Write `leaderboard.{md,csv,json,tex}` beside `records.jsonl`, each whole or not at all; returns their paths."""
    board = groups(record_files.read(run_dir / "records.jsonl"))
    return [write_text(run_dir / f"leaderboard.{suffix}", writer(board)) for suffix, writer in WRITERS.items()]


def write_text(path: Path, text: str) -> Path:
    """Replace a file in one step, so that a full disk or an interruption leaves the old one."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return path
