"""Naive formulas put in place of the sound ones: the cases must notice. What keeps the scoreboard from being vacuous.

One file per topic; every `Mutant` in them is found. Compiled formulas are dropped before and after a mutant, so that none
outlives the patch. A mutant counts as killed only by cells that hold without it, on some of their members.
"""

import pkgutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from typing import Any
from unittest.mock import patch

import jax

from prt_bench.stability.board import HEADROOM, Kill
from prt_bench.stability.cases import cases
from prt_bench.stability.cell import Case, Cell, run_cell
from prt_bench.stability.processes import spread
from prt_bench.stability.routes import F32, F64, Route

_MEMBERS = 16
"""Members of each family that a mutant is shown."""


@dataclass(frozen=True)
class Mutant:
    """`wrong` is put wherever `replaces` (module:name, or module:class.name) is used; `titles` begin the cases that judge it.

    `wrong` is called with the sound formula and returns the naive one. With a `subject`, the first one that begins so judges.
    """

    name: str
    replaces: str
    wrong: Callable[[Any], Any]
    titles: tuple[str, ...]
    subject: str = ""
    routes: tuple[Route, ...] = (F64, F32)


def mutant(
    name: str, replaces: str, *titles: str, subject: str = "", routes: tuple[Route, ...] = (F64, F32)
) -> Callable[[Callable[[Any], Any]], Mutant]:
    """Make a mutant of a function from the sound formula to the naive one."""
    return lambda wrong: Mutant(name, replaces, wrong, titles, subject, routes)


@cache
def mutants() -> tuple[Mutant, ...]:
    """All mutants, in the order of their files."""
    modules = [import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]
    return tuple(value for module in modules for value in vars(module).values() if isinstance(value, Mutant))


_Sound = dict[tuple[str, str, str, str, str], bool]


def kills(
    chosen: Sequence[Mutant] | None = None, known: Sequence[Cell] = (), progress: bool = True, jobs: int | None = 1
) -> list[Kill]:
    """Run every mutant against its cells, in `jobs` processes (None: one a core).

    The outcomes of cells that are `known` already are not measured again. Mutants that are not among `mutants()` run in
    this process alone.
    """
    chosen = mutants() if chosen is None else chosen
    sound: _Sound = {(cell.case, cell.title, cell.kind, cell.subject, cell.route): _holds(cell) for cell in known}
    if jobs == 1:
        return list(spread(partial(_kill, sound=sound), chosen, "mutants", 1, progress))
    places = [mutants().index(each) for each in chosen]
    return list(spread(partial(_kill_at, sound=sound), places, "mutants", jobs, progress))


def _kill_at(place: int, sound: _Sound) -> Kill:
    return _kill(mutants()[place], sound)


def _kill(each: Mutant, sound: _Sound) -> Kill:
    cells = list(_cells(each))
    for cell in cells:
        if _key(*cell) not in sound:
            sound[_key(*cell)] = _holds(run_cell(*cell, _MEMBERS))
    with _in_place(each):
        found = [run_cell(*cell, _MEMBERS) for cell in cells if sound[_key(*cell)]]
    return Kill(each.name, each.replaces, tuple(cell.name for cell in found if not _holds(cell)))


def _key(case: Case, subject: str, route: Route) -> tuple[str, str, str, str, str]:
    return case.key, case.title, str(case.kind), subject, route.name


def _cells(each: Mutant) -> Iterator[tuple[Case, str, Route]]:
    for case in cases():
        if not case.title.startswith(each.titles):
            continue
        subjects = [subject for subject in case.subjects() if subject.startswith(each.subject)]
        if each.subject:
            subjects = subjects[:1]  # the plain method stands for its variants
        yield from ((case, subject, route) for route in case.routes if route in each.routes for subject in subjects)


def _holds(cell: Cell) -> bool:
    return cell.sound and (cell.headroom or 0.0) <= HEADROOM


@contextmanager
def _in_place(each: Mutant) -> Iterator[None]:
    """The naive formula under every name by which a module of ours holds the sound one."""
    module, _, path = each.replaces.partition(":")
    *owners, name = path.split(".")
    home = import_module(module)
    with ExitStack() as stack:
        if owners:
            owner = getattr(home, owners[0])
            stack.enter_context(patch.object(owner, name, each.wrong(getattr(owner, name))))
        else:
            sound = getattr(home, name)
            naive = each.wrong(sound)
            for holder in list(sys.modules.values()):
                if getattr(holder, "__name__", "").split(".")[0] in ("prt_bench", "data_gen"):
                    for held in [held for held, value in vars(holder).items() if value is sound]:
                        stack.enter_context(patch.object(holder, held, naive))
        jax.clear_caches()
        stack.callback(jax.clear_caches)
        yield
