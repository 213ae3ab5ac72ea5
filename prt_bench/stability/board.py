"""The scoreboard: all cells, the aggregates beside their goals, and both as JSON for a run's report.

Printing is in `table`; the mutants' harness in `mutants`.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from prt_bench.errors import SpecError
from prt_bench.records import provenance
from prt_bench.stability.cases import cases
from prt_bench.stability.cell import Case, Cell, Kind, Outcome, run_cell
from prt_bench.stability.journal import Journal, Name, name_of
from prt_bench.stability.processes import spread
from prt_bench.stability.routes import ROUTES

FILE = "stability.json"
"""Name of the scoreboard in a run's folder."""
SCHEMA = 1
HEADROOM = 10.0
KILLED = 0.95


@dataclass(frozen=True)
class Goal:
    """An aggregate: its value as text, the goal as text, and whether it is met. `missed` names what stands against it."""

    name: str
    value: str
    goal: str
    met: bool
    missed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kill:
    """One naive formula in place of the sound one, and the cells that noticed."""

    name: str
    replaces: str
    noticed: tuple[str, ...]

    @property
    def killed(self) -> bool:
        """Whether any cell noticed."""
        return bool(self.noticed)


def selected(keys: Sequence[str] = ()) -> list[Case]:
    """The cases whose catalogue key is among `keys`; all without keys. Raises `SpecError` for an unknown key."""
    known = {case.key for case in cases()}
    if unknown := sorted(set(keys) - known):
        raise SpecError(f"there is no case '{unknown[0]}'; cases are {', '.join(sorted(known))}")
    return [case for case in cases() if not keys or case.key in keys]


_Place = tuple[int, str, int]
"""A cell by the places of its case and route, and its subject: what another process can be told."""


def run(
    chosen: Iterable[Case],
    routes: Sequence[str] = (),
    progress: bool = True,
    jobs: int | None = 1,
    journal: Journal | None = None,
) -> list[Cell]:
    """Every cell of the chosen cases, in the routes named (all without names), in `jobs` processes (None: one a core).

    With a `journal` cells that it holds are not measured again, and it is told every other one at once.
    """
    places = list(_places(chosen, routes))
    known = journal.cells if journal else {}
    new = [place for place in places if _name(place) not in known]
    found = dict(known)
    for cell in spread(_cell, new, "stability", jobs, progress):
        found[name_of(cell)] = cell
        if journal:
            journal.add(cell)
    return [found[_name(place)] for place in places]


def _places(chosen: Iterable[Case], routes: Sequence[str]) -> Iterator[_Place]:
    for case in chosen:
        for route in case.routes:
            if not routes or route.name in routes:
                yield from ((cases().index(case), subject, ROUTES.index(route)) for subject in case.subjects())


def _name(place: _Place) -> Name:
    case, subject, route = place
    return cases()[case].key, cases()[case].title, str(cases()[case].kind), subject, ROUTES[route].name


def _cell(place: _Place) -> Cell:
    case, subject, route = place
    return run_cell(cases()[case], subject, ROUTES[route])


def goals(cells: Sequence[Cell], kills: Sequence[Kill] = ()) -> list[Goal]:
    """The aggregates. Those that nothing was measured for are left out."""
    silent = [cell for cell in cells if cell.outcome == Outcome.SILENT]
    rooms = [cell for cell in cells if cell.headroom is not None]
    found = [
        _share("pass rate", cells, [cell for cell in cells if not cell.sound]),
        Goal("silent failures", str(len(silent)), "0", not silent, tuple(cell.name for cell in silent)),
    ]
    for name, kind in (("gradient-safe", Kind.GRADIENT), ("refusal honesty", Kind.REFUSAL)):
        asked = [cell for cell in cells if cell.kind == kind]
        if asked:
            found.append(_share(name, asked, [cell for cell in asked if not cell.sound]))
    if rooms:
        most = max(rooms, key=lambda cell: cell.headroom or 0.0)
        room = most.headroom or 0.0
        above = tuple(cell.name for cell in rooms if (cell.headroom or 0.0) > HEADROOM)
        found.append(Goal("headroom: error / (eps·κ)", f"{room:.2g}", f"≤ {HEADROOM:g}", room <= HEADROOM, above))
    if kills:
        share = sum(kill.killed for kill in kills) / len(kills)
        survivors = tuple(kill.name for kill in kills if not kill.killed)
        text = f"{share:.0%} of {len(kills)}"
        found.append(Goal("mutants killed", text, f"≥ {KILLED:.0%}", share >= KILLED, survivors))
    return found


def _share(name: str, asked: Sequence[Cell], failed: Sequence[Cell]) -> Goal:
    share = 1.0 - len(failed) / max(len(asked), 1)
    text = f"{share:.1%} of {len(asked)} cells"
    return Goal(name, text, "100 %", not failed, tuple(cell.name for cell in failed))


def write(path: Path, cells: Sequence[Cell], kills: Sequence[Kill] = ()) -> Path:
    """Write the scoreboard as JSON: into a folder as `stability.json`, else to the file named."""
    target = check_target(path)
    text = json.dumps(as_json(cells, kills), indent=1, ensure_ascii=False)
    partial = target.with_name(target.name + ".partial")
    partial.write_text(text + "\n", encoding="utf-8")
    partial.replace(target)
    return target


def check_target(path: Path) -> Path:
    """The file that `write` would write. Raises `SpecError` where there is no folder for it."""
    target = path / FILE if path.is_dir() else path
    if not target.parent.is_dir():
        raise SpecError(f"{target.parent} is not a folder; --out takes a run's folder or a file in an existing one")
    return target


def as_json(cells: Sequence[Cell], kills: Sequence[Kill]) -> dict[str, Any]:
    """Goals, cells, mutants and provenance as plain data."""
    return {
        "schema": SCHEMA,
        "goals": [asdict(goal) for goal in goals(cells, kills)],
        "cells": [asdict(cell) for cell in cells],
        "mutants": [asdict(kill) for kill in kills],
        "provenance": provenance(),
    }
