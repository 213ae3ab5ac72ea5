"""Questions to records: how two methods compare, and what is the most accurate within a budget of time or memory."""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table
from rich.text import Text

from prt_bench import records as record_files
from prt_bench.errors import SpecError
from prt_bench.records import Record
from prt_bench.report.frontier import METRICS, Metric, Row
from prt_bench.report.leaderboard import MISSING, figure
from prt_bench.report.ranking import Group, groups, tied


@dataclass(frozen=True)
class Comparison:
    """Row `a` against row `b` of one group; ratios are a / b, None where either figure was not measured or b's is 0.

    Time is the GL frame; where a row has none, the three JAX stages. Bytes are what the runtime holds.
    """

    group: Group
    a: Row
    b: Row
    error: float | None
    time: float | None
    bytes: float | None
    tied: bool


def compare(records: Iterable[Record], a: str, b: str) -> list[Comparison]:
    """Compare two rows by label, or two methods by name (the most accurate row of each), wherever both are present.

    Raises `SpecError` when a name is unknown (names the nearest) or the two never meet.
    """
    board = groups(records)
    for name in (a, b):
        _require_known(board, name)
    found = []
    for group in board:
        first, second = _pick(group, a), _pick(group, b)
        if first is not None and second is not None:
            clock = "frame_ms" if all(METRICS["frame_ms"].of(row) is not None for row in (first, second)) else "jax_ms"
            error, time, size = (_ratio(name, first, second) for name in ("relative_rmse", clock, "runtime_bytes"))
            found.append(Comparison(group, first, second, error, time, size, tied(first, second)))
    if not found:
        raise SpecError(
            f"'{a}' and '{b}' never ran on the same scene, scenario, split and device; run both in one spec"
        )
    return found


def _require_known(board: Iterable[Group], name: str) -> None:
    known = dict.fromkeys(
        known
        for group in board
        for entry in group.entries
        for known in (entry.row.record.method, entry.row.record.label)
    )
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
        hint = f"; the nearest is '{near[0]}'" if near else ""
        raise SpecError(f"no record is of a method or label '{name}'{hint}")


def _pick(group: Group, name: str) -> Row | None:
    """The row with that label, else the best-placed row of that method. Entries come best first."""
    rows = [entry.row for entry in group.entries]
    by_label = [row for row in rows if row.record.label == name]
    return next(iter(by_label or [row for row in rows if row.record.method == name]), None)


def _ratio(metric: str, a: Row, b: Row) -> float | None:
    first, second = METRICS[metric].of(a), METRICS[metric].of(b)
    return None if first is None or not second else first / second


@dataclass(frozen=True)
class Budget:
    """An upper limit on one metric, in that metric's unit."""

    metric: Metric
    limit: float


_UNITS = {
    "us": ("indirect_ms", 1e-3), "µs": ("indirect_ms", 1e-3), "ms": ("indirect_ms", 1.0),
    "s": ("prepare_s", 1.0), "min": ("prepare_s", 60.0),
    "b": ("runtime_bytes", 1.0), "kb": ("runtime_bytes", 1e3),
    "mb": ("runtime_bytes", 1e6), "gb": ("runtime_bytes", 1e9),
    "kib": ("runtime_bytes", 2.0**10), "mib": ("runtime_bytes", 2.0**20), "gib": ("runtime_bytes", 2.0**30),
}  # fmt: skip


def parse_budget(within: str) -> Budget:
    """`0.5ms` (what indirect light adds to a frame), `2MB` (what the runtime holds) or `10s` (bake and fit).

    Raises `SpecError` on anything else.
    """
    match = re.fullmatch(r"\s*(\d+\.?\d*(?:e[+-]?\d+)?|\.\d+)\s*([a-zµ]+)\s*", within.lower().replace("μ", "µ"))
    if match is None or match[2] not in _UNITS:
        raise SpecError(f"the budget '{within}' is not a number with a unit; write 0.5ms, 2MB or 10s")
    name, scale = _UNITS[match[2]]
    return Budget(METRICS[name], float(match[1]) * scale)


@dataclass(frozen=True)
class Best:
    """A group's rows within a budget: the most accurate first, then those tied with it. Empty where nothing fits."""

    group: Group
    budget: Budget
    rows: tuple[Row, ...]

    @property
    def cheapest(self) -> Row | None:
        """The cheapest competing row of the group, to tell what the least budget would be."""
        costs = [(cost, row) for row in _competing(self.group) if (cost := self.budget.metric.of(row)) is not None]
        return min(costs, key=lambda pair: pair[0])[1] if costs else None


def _competing(group: Group) -> list[Row]:
    return [entry.row for entry in group.entries if entry.rank is not None]


def best(records: Iterable[Record], within: str) -> list[Best]:
    """For every group, the most accurate competing rows whose cost is known and within the budget.

    Raises `SpecError` when the budget cannot be read.
    """
    budget = parse_budget(within)
    found = []
    for group in groups(records):
        fitting = [
            row for row in _competing(group) if (cost := budget.metric.of(row)) is not None and cost <= budget.limit
        ]  # fmt: skip
        found.append(Best(group, budget, tuple(row for row in fitting if tied(fitting[0], row))))
    return found


def _read(path: Path) -> list[Record]:
    return record_files.read(path / "records.jsonl" if path.is_dir() else path)


def compare_table(path: Path, a: str, b: str) -> Table:
    """`compare` on a run folder or a records file, as a table to print."""
    found = compare(_read(path), a, b)
    table = _table(f"{a} against {b}, as ratios", [comparison.group for comparison in found])
    for head in ("Error", "Time", "Bytes"):
        table.add_column(head, justify="right")
    table.add_column("Verdict")
    for comparison in found:
        ratios = (comparison.error, comparison.time, comparison.bytes)
        cells = (Text(MISSING if ratio is None else f"{ratio:.3g}×") for ratio in ratios)
        table.add_row(_where(table, comparison.group), *cells, Text(_verdict(comparison)))
    return table


def _verdict(found: Comparison) -> str:
    names = [found.a.record.label, found.b.record.label]
    if found.error is None:
        return f"unknown: {names[0]} or {names[1]} has no error to compare"
    if found.tied:
        return f"{names[0]} is tied with {names[1]}"
    return " over ".join(names if found.error < 1 else names[::-1])


def best_table(path: Path, within: str) -> Table:
    """`best` on a run folder or a records file, as a table to print."""
    found = best(_read(path), within)
    table = _table(f"The most accurate within {within.strip()}", [answer.group for answer in found])
    table.add_column("Method")
    table.add_column("Rel. RMSE", justify="right")
    table.add_column(parse_budget(within).metric.label, justify="right")
    for answer in found:
        where = _where(table, answer.group)
        for row in answer.rows:
            error = figure("relative_rmse", METRICS["relative_rmse"].of(row))
            label = row.record.label + (" (tied)" if len(answer.rows) > 1 else "")
            table.add_row(where, Text(label), error, _cost(answer, row))
        if not answer.rows:
            table.add_row(where, Text(_nothing(answer)), "", "")
    return table


def _table(title: str, found: Iterable[Group]) -> Table:
    """An empty table; its caption names the device, or its rows do where there are several."""
    devices = list(dict.fromkeys(group.device for group in found))
    caption = Text(devices[0]) if len(devices) == 1 else None
    table = Table("Scene · scenario · split", title=Text(title, "bold"), caption=caption, box=None, header_style="dim")
    table.title_justify = table.caption_justify = "left"
    return table


def _where(table: Table, group: Group) -> Text:
    return Text(group.title if table.caption else f"{group.title} on {group.device}")


def _cost(answer: Best, row: Row) -> str:
    metric = answer.budget.metric
    text = figure(metric.name, metric.of(row))
    return text if metric.unit == "bytes" else f"{text} {metric.unit}"


def _nothing(answer: Best) -> str:
    row = answer.cheapest
    if row is None:
        return f"nothing has a figure for: {answer.budget.metric.label.lower()}"
    return f"nothing fits; the cheapest is {row.record.label} at {_cost(answer, row)}"
