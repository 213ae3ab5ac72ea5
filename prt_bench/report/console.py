"""The leaderboard as the terminal shows it at the end of a run: the few columns that decide, one table per group."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from prt_bench.records import Record
from prt_bench.report.leaderboard import Column, figure
from prt_bench.report.leaderboard import columns as named
from prt_bench.report.ranking import Entry, Group, groups

WIDE = named("rank", "label", "relative_rmse", "flip", "frame_ms", "indirect_ms", "runtime_bytes", "bake_s", "fit_s")
NARROW = named("rank", "label", "relative_rmse", "frame_ms", "indirect_ms", "runtime_bytes")


@dataclass(frozen=True)
class Board:
    """The groups, printed one under the other; a narrow terminal gets fewer columns."""

    groups: Sequence[Group]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Rich's protocol for printing."""
        for group in self.groups:
            yield _table(group, WIDE if options.max_width >= 110 else NARROW)
            yield ""


def leaderboard(records: Iterable[Record]) -> Board:
    """The leaderboard of some records, for a rich console to print."""
    return Board(groups(records))


def _table(group: Group, columns: Sequence[Column]) -> Table:
    noise = figure("relative_rmse", group.noise_floor)
    table = Table(
        title=Text(group.title, "bold"),
        caption=Text(f"{group.device}. Noise floor {noise}; ranks marked = are tied under it."),
        title_justify="left", caption_justify="left", box=None, header_style="dim", padding=(0, 1),
    )  # fmt: skip
    for column in columns:
        head = Text(f"{column.head} {column.unit}".strip())
        table.add_column(head, justify="right" if column.numeric else "left", no_wrap=True)
    table.add_column("Status", no_wrap=True)
    for entry in group.entries:
        cells: Sequence[Text] = [Text(column.text(entry)) for column in columns]
        table.add_row(
            *cells, Text(_status(entry)), style="dim" if entry.rank is None else "bold" if entry.rank == 1 else ""
        )
    return table


def _status(entry: Entry) -> str:
    """The status alone: reasons are a sentence long, and stand in the other tables."""
    record = entry.row.record
    return record.role if record.status == "ok" and record.role != "method" else record.status
