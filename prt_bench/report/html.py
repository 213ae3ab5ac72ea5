"""`report.html`: one file that reads offline. Gathers what the page shows from records and pictures.

Frontiers, ranks and ties are computed here, in Python; the page's scripts only draw what they are given.
"""

import base64
import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image
from plotly.colors import sequential
from plotly.offline import get_plotlyjs

from prt_bench import records as record_files
from prt_bench.errors import DatasetError
from prt_bench.records import Record
from prt_bench.report.embed import LEVELS, Pair, embed
from prt_bench.report.frontier import COST_AXES, ERROR_AXES, METRICS, Row, frontier
from prt_bench.report.leaderboard import COLUMNS, figure, status, write_text
from prt_bench.report.planner import planned
from prt_bench.report.ranking import TIE_RULE, Group, groups
from prt_bench.report.stability import read_scoreboard

PICTURE_BUDGET = 9_000_000
"""Bytes for all embedded HDR pictures together: they shrink until they fit, which keeps the page under 15 MB."""

VIEWS = {"final": ("prediction", "reference"), "indirect": ("indirect", "indirect_reference")}
ERROR_PARTS = ("noise_floor", "projection", "coefficient", "storage", "runtime")


def write_report(run_dir: Path) -> Path:
    """Write `report.html` from `records.jsonl` and the pictures beside it, whole or not at all; returns its path.

    Raises `DatasetError` when the records or a picture they name cannot be read.
    """
    board = groups(record_files.read(run_dir / "records.jsonl"))
    pairs = {entry.row: _pairs(run_dir, entry.row) for group in board for entry in group.entries}
    keys, pictures = embed(pairs.values(), PICTURE_BUDGET)
    shown = {row: {view: keys[pair] for view, pair in views.items()} for row, views in pairs.items()}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("prt_bench.report"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.globals |= {
        "figure": figure,
        "columns": COLUMNS,
        "reasons": _reasons,
        "static": lambda name: _static(environment, name),
    }
    page = environment.get_template("report.html.j2").render(
        board=board,
        data=page_data(board, shown),
        pictures=pictures,
        plans=_plans(run_dir, board),
        machines=_machines(board),
        assets=_assets(board),
        stability=read_scoreboard(run_dir),
        bands=[(band, len(list(members))) for band, members in itertools.groupby(COLUMNS, lambda column: column.band)],
        tie_rule=TIE_RULE,
        plotly=Markup(get_plotlyjs()),
    )
    return write_text(run_dir / "report.html", page)


def _reasons(group: Group) -> list[tuple[str, str, list[str]]]:
    """Why rows are not ok: each status and reason once, with the labels it is of. They would make a column too wide."""
    found: dict[tuple[str, str], list[str]] = {}
    for entry in group.entries:
        record = entry.row.record
        if record.reason:
            found.setdefault((record.status, record.reason.removesuffix(".")), []).append(record.label)
    return [(status, reason, labels) for (status, reason), labels in found.items()]


def _static(environment: jinja2.Environment, name: str) -> Markup:
    """A script or style sheet of ours, verbatim."""
    loader = environment.loader
    assert loader is not None
    return Markup(loader.get_source(environment, name)[0])


def page_data(board: Sequence[Group], pictures: Mapping[Row, Mapping[str, tuple[str, str]]]) -> dict[str, Any]:
    """What the scripts draw. `pictures` gives for a row's views the keys of the difference and of the reference."""
    return {
        "metrics": {
            metric.name: {"label": metric.label, "unit": metric.unit, "log": metric.log} for metric in METRICS.values()
        },
        "axes": {"x": COST_AXES, "y": ERROR_AXES},
        "parts": ERROR_PARTS,
        "groups": [_group_data(group, pictures) for group in board],
        "levels": LEVELS,
        "colormap": _colormap(),
    }


def _colormap() -> list[list[int]]:
    """256 colours of magma, as FLIP shows errors."""
    anchors = np.array([[int(hexa[i : i + 2], 16) for i in (1, 3, 5)] for hexa in sequential.Magma])
    at = np.linspace(0, len(anchors) - 1, 256)
    return (
        np.stack([np.interp(at, np.arange(len(anchors)), channel) for channel in anchors.T], 1)
        .round()
        .astype(int)
        .tolist()
    )


def _group_data(group: Group, pictures: Mapping[Row, Mapping[str, tuple[str, str]]]) -> dict[str, Any]:
    members = [entry.row for entry in group.entries]
    return {
        **{name: getattr(group, name) for name in ("scene", "scenario", "split", "device", "title")},
        "noise": group.noise_floor,
        "rows": [
            {**_row_data(entry.row), "place": entry.place, "pictures": pictures[entry.row]} for entry in group.entries
        ],
        "frontiers": {
            f"{x} {y}": frontier(members, METRICS[x], METRICS[y]) for x in COST_AXES for y in ERROR_AXES
        },
        "curves": _curves(members),
        "trainings": _trainings(members),
    }  # fmt: skip


def _row_data(row: Row) -> dict[str, Any]:
    record = row.record
    return {
        "label": record.label,
        "method": record.method,
        "kind": _kind(record),
        "status": status(row),
        "values": {metric.name: metric.of(row) for metric in METRICS.values()},
        "shown": {metric.name: figure(metric.name, metric.of(row)) for metric in METRICS.values()},
        "spread": {metric.name: spread for metric in METRICS.values() if (spread := metric.spread(row)) is not None},
        "errors": asdict(record.errors),
    }


def _kind(record: Record) -> str:
    """What the charts' markers tell apart."""
    return record.status if record.status in ("oracle", "failed", "timeout") else record.role


def _curves(members: Iterable[Row]) -> list[dict[str, Any]]:
    """Singular values relative to the first; settings of a method that share a curve are drawn once, at its longest."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, Any]] = {}
    for row in members:
        values = row.record.curves.get("singular_values") or []
        if values and values[0] > 0:
            relative = [value / values[0] for value in values]
            key = row.record.method, tuple(f"{value:.6g}" for value in relative[:4])
            if key not in found or len(found[key]["values"]) < len(relative):
                found[key] = {
                    "kind": _kind(row.record),
                    "method": row.record.method,
                    "label": row.record.label,
                    "values": relative,
                }
    return list(found.values())


def _trainings(members: Iterable[Row]) -> list[dict[str, Any]]:
    """Of every row that was trained: the error on lightings held out, relative to the one it began with, by steps."""
    found = []
    for row in members:
        curves = row.record.curves
        steps, error = curves.get("training_steps") or [], curves.get("validation_error") or []
        if steps and error and error[0] > 0:
            found.append(
                {
                    "kind": _kind(row.record),
                    "method": row.record.method,
                    "label": row.record.label,
                    "steps": steps,
                    "error": [value / error[0] for value in error],
                    "best": int(np.argmin(error)),
                }
            )
    return found


def _pairs(run_dir: Path, row: Row) -> dict[str, Pair]:
    """The row's pictures beside their references, by view."""
    found = row.record.pictures
    return {
        view: Pair(*(_inside(run_dir, found[name]) for name in names))
        for view, names in VIEWS.items()
        if all(name in found for name in names)
    }


def _inside(run_dir: Path, path: str) -> Path:
    """The path of a picture, which must lie in the run folder."""
    found = (run_dir / path).resolve()
    if not found.is_relative_to(run_dir.resolve()) or not found.is_file():
        raise DatasetError(f"the picture '{path}' that the records of {run_dir} name is not in that folder; run again")
    return found


def _plans(run_dir: Path, board: Iterable[Group]) -> list[dict[str, Any]]:
    """Per scene and scenario: what the planner decided, left out and predicted, and the dataset's settings and hashes."""
    records = [entry.row.record for group in board for entry in group.entries]
    found = {(plan["scene"], plan["scenario"]): {**plan, "settings": {}, "points": None} for plan in planned(records)}
    for record in records:
        plan = found[record.scene, record.scenario]
        plan["settings"] |= {
            name: value for name, value in record.dataset.items()
            if name not in ("plan", "effects") and isinstance(value, str | int | float)
        }  # fmt: skip
        if plan["points"] is None and (path := record.pictures.get("measurement_points")):
            plan["points"] = _data_url(_inside(run_dir, path))
    return list(found.values())


def _data_url(path: Path, width: int = 800) -> str:
    """A PNG as a data URL, shrunk to `width` pixels where it is wider."""
    with Image.open(path) as image:
        small = image.convert("RGB")
    small.thumbnail((width, width))
    file = io.BytesIO()
    small.save(file, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def _machines(board: Iterable[Group]) -> list[dict[str, Any]]:
    """The distinct provenances of the records (versions, commit, hardware), less their dates, which become a range."""
    found: dict[str, dict[str, Any]] = {}
    for group in board:
        for entry in group.entries:
            facts = dict(entry.row.record.provenance)
            date = facts.pop("date", None)
            packages = facts.pop("packages", {})
            facts["packages"] = ", ".join(f"{name} {version}" for name, version in packages.items())
            machine = found.setdefault(repr(facts), {"facts": {k: v for k, v in facts.items() if v}, "dates": set()})
            machine["dates"] |= {date} if date else set()
    return [{"dates": sorted(machine["dates"]), "facts": machine["facts"]} for machine in found.values()]


def _assets(board: Iterable[Group]) -> list[tuple[str, str, str, str, str]]:
    """Scene, scenario, label, data type and hash of every asset."""
    rows = (entry.row.record for group in board for entry in group.entries)
    return list(
        dict.fromkeys(
            (row.scene, row.scenario, row.label, str(row.asset.get("dtype", "")), row.asset["sha256"])
            for row in rows
            if "sha256" in row.asset
        )
    )
