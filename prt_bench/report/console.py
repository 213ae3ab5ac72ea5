"""The leaderboard as the terminal shows it at the end of a run: the few columns that decide, one table per group."""

from collections.abc import Iterable, Sequence

from rich.console import Group as Lines
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from prt_bench.records import Record
from prt_bench.report.leaderboard import columns, figure
from prt_bench.report.ranking import Entry, Group, groups

COLUMNS = columns(
    "rank", "label", "relative_rmse", "flip", "frame_ms", "indirect_ms", "runtime_bytes", "bake_s", "fit_s"
)


def leaderboard(records: Iterable[Record]) -> RenderableType:
    """The groups as rich tables, one under the other."""
    return Lines(*(_table(group) for group in groups(records)))


def _table(group: Group) -> Table:
    noise = figure("relative_rmse", group.noise_floor)
    table = Table(
        title=Text(group.title, "bold"),
        caption=Text(f"{group.device}. Noise floor {noise}; ranks marked = are tied under it."),
        title_justify="left", caption_justify="left", box=None, header_style="dim", padding=(0, 1),
    )  # fmt: skip
    for column in COLUMNS:
        head = Text(f"{column.head} {column.unit}".strip())
        table.add_column(head, justify="right" if column.numeric else "left", no_wrap=column.numeric)
    table.add_column("Status", no_wrap=True)
    for entry in group.entries:
        cells: Sequence[Text] = [Text(column.text(entry)) for column in COLUMNS]
        table.add_row(
            *cells, Text(_status(entry)), style="dim" if entry.rank is None else "bold" if entry.rank == 1 else ""
        )
    return table


def _status(entry: Entry) -> str:
    """The status alone: reasons are a sentence long, and stand in the other tables."""
    record = entry.row.record
    return record.role if record.status == "ok" and record.role != "method" else record.status
