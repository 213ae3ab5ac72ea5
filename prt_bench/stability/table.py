"""The scoreboard on a terminal: cases by routes, what failed, and the goals."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from prt_bench.stability.board import Goal, Kill
from prt_bench.stability.cell import Cell
from prt_bench.stability.routes import ROUTES


def show(console: Console, cells: Sequence[Cell], kills: Sequence[Kill], found: Sequence[Goal]) -> None:
    """Print everything: one row per case and kind, one column per route, a sentence per failure."""
    if cells:
        console.print(_matrix(cells))
    for cell in cells:
        if not cell.sound:
            console.print(Text(f"{cell.name}: {cell.outcome}. {cell.worst}", "red"), soft_wrap=True)
    if kills:
        console.print(_mutants(kills))
    console.print(_summary(found))


def _matrix(cells: Sequence[Cell]) -> Table:
    table = _plain("Stability: cells that hold, of all subjects")
    for head in ("Case", "", "Kind", *(route.name for route in ROUTES), "Headroom"):
        table.add_column(head, no_wrap=head != "")
    rows: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        rows.setdefault((cell.case, cell.title, cell.kind), []).append(cell)
    for (key, title, kind), members in rows.items():
        per_route = [[cell for cell in members if cell.route == route.name] for route in ROUTES]
        rooms = [cell.headroom for cell in members if cell.headroom is not None]
        table.add_row(key, title, kind, *map(_count, per_route), f"{max(rooms):.2g}" if rooms else "")
    return table


def _count(members: Sequence[Cell]) -> Text:
    if not members:
        return Text("–", "dim")
    sound = sum(cell.sound for cell in members)
    refused = sum(cell.outcome == "refused" for cell in members)
    text = f"{sound}/{len(members)}" + (f" ({refused} refused)" if refused else "")
    return Text(text, "green" if sound == len(members) else "bold red")


def _mutants(kills: Sequence[Kill]) -> Table:
    table = _plain("Naive formulas in place of the sound ones")
    for head in ("Formula", "Replaces", "Noticed by"):
        table.add_column(head)
    for kill in kills:
        cases = list(dict.fromkeys(cell.split(" · ")[0] for cell in kill.noticed))
        told = f"{len(kill.noticed)} cells: {', '.join(cases)}" if kill.killed else "nothing"
        table.add_row(kill.name, kill.replaces, Text(told, "" if kill.killed else "bold red"))
    return table


def _summary(found: Sequence[Goal]) -> Table:
    table = _plain("Goals")
    for head in ("", "Measured", "Goal", ""):
        table.add_column(head)
    for goal in found:
        table.add_row(
            goal.name, goal.value, goal.goal, Text("met", "green") if goal.met else Text("missed", "bold red")
        )
    return table


def _plain(title: str) -> Table:
    return Table(title=Text(title, "bold"), title_justify="left", box=None, header_style="dim", padding=(0, 1))
