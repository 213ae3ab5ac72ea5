"""What a case and a cell are, and how a cell is judged.

A case is a family of inputs and a check; it is run for every subject (a method, a function, a light) and dtype route. A cell is
as bad as its worst member.
"""

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from prt_bench.errors import PrtBenchError
from prt_bench.stability.routes import ROUTES, Route


class Kind(StrEnum):
    """What a case asks: right values, right derivatives, or a refusal of what has no answer."""

    VALUE = "value"
    GRADIENT = "gradient"
    REFUSAL = "refusal"


class Outcome(StrEnum):
    """From best to worst. A typed error or a warning is a refusal; NaN, infinity and other errors fail loudly."""

    PASSED = "passed"
    REFUSED = "refused"
    LOUD = "failed loudly"
    SILENT = "failed silently"

    @property
    def sound(self) -> bool:
        """Whether nothing went wrong."""
        return self in (Outcome.PASSED, Outcome.REFUSED)


class Member(NamedTuple):
    """One input of a family. What is `ill_posed` must be refused, by a typed error or a warning."""

    name: str
    data: Any
    ill_posed: bool = False


class Measured(NamedTuple):
    """An error beside its bound. `unit` is eps · κ_λ where the error is one of rounding, for the headroom."""

    error: float
    bound: float
    unit: float | None = None


@dataclass(frozen=True)
class Case:
    """`check` measures one member for one subject; for refusals it returns whether the member was flagged."""

    key: str
    title: str
    kind: Kind
    subjects: Callable[[], Mapping[str, Any]]
    family: Callable[[Route], Iterable[Member]]
    check: Callable[[Any, Any, Route], Iterable[Measured] | bool]
    routes: tuple[Route, ...]


@dataclass(frozen=True)
class Cell:
    """The outcome of a case for one subject and route. `worst` names the member that decided it."""

    case: str
    title: str
    kind: str
    subject: str
    route: str
    outcome: str
    members: int
    headroom: float | None
    worst: str

    @property
    def sound(self) -> bool:
        """Whether nothing went wrong."""
        return Outcome(self.outcome).sound

    @property
    def name(self) -> str:
        """The cell as one line of text."""
        return f"{self.case} {self.kind} · {self.subject} · {self.route}"


class _Verdict(NamedTuple):
    outcome: Outcome
    margin: float  # error over bound
    headroom: float | None
    worst: str


def case(
    key: str,
    title: str,
    *,
    subjects: Callable[[], Mapping[str, Any]],
    family: Callable[[Route], Iterable[Member]],
    kind: Kind = Kind.VALUE,
    routes: tuple[Route, ...] = ROUTES,
) -> Callable[[Callable[[Any, Any, Route], Iterable[Measured] | bool]], Case]:
    """Make a case of a check. `key` is the entry of the catalogue of hard cases that it comes from."""
    return lambda check: Case(key, title, kind, subjects, family, check, routes)


def run_cell(hard: Case, subject: str, route: Route, most: int | None = None) -> Cell:
    """Judge every member of a case's family, or `most` drawn from it. Never raises for what the subject does wrong."""
    tested = hard.subjects()[subject]
    members = list(hard.family(route))
    drawn = np.random.default_rng(0).permutation(len(members))[:most]
    verdicts = [_judge(hard, tested, members[index], route) for index in drawn]
    order = list(Outcome)
    worst = max(verdicts, key=lambda verdict: (order.index(verdict.outcome), verdict.margin))
    outcome = worst.outcome
    if outcome is Outcome.REFUSED and any(verdict.outcome is Outcome.PASSED for verdict in verdicts):
        outcome = Outcome.PASSED  # some members ill-posed, others solved
    rooms = [verdict.headroom for verdict in verdicts if verdict.headroom is not None]
    return Cell(
        hard.key, hard.title, str(hard.kind), subject, route.name, str(outcome), len(verdicts),
        max(rooms) if rooms else None, worst.worst,
    )  # fmt: skip


def _judge(hard: Case, tested: Any, member: Member, route: Route) -> _Verdict:
    must_refuse = member.ill_posed or hard.kind is Kind.REFUSAL
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answer = hard.check(tested, member.data, route)
            found = [] if isinstance(answer, bool) else list(answer)
            flagged = answer is True
        except PrtBenchError as error:
            outcome = Outcome.REFUSED if must_refuse else Outcome.LOUD
            return _Verdict(outcome, 0.0, None, f"{member.name}: {error}")
        except Exception as error:
            return _Verdict(Outcome.LOUD, np.inf, None, f"{member.name}: {type(error).__name__}: {error}")
    flagged = flagged or any(warning.category is UserWarning for warning in caught)
    if must_refuse:
        outcome = Outcome.REFUSED if flagged else Outcome.SILENT
        return _Verdict(outcome, 0.0, None, f"{member.name}: {'flagged' if flagged else 'answered without a word'}")
    return _worst(member.name, found)


def _worst(name: str, found: list[Measured]) -> _Verdict:
    margins = [each.error / each.bound if each.bound > 0 else np.inf * (each.error > 0 or np.nan) for each in found]
    margins = [0.0 if each.error == 0 else margin for each, margin in zip(found, margins, strict=True)]
    if not np.all(np.isfinite([each.error for each in found])):
        return _Verdict(Outcome.LOUD, np.inf, None, f"{name}: not finite")
    at = int(np.argmax(margins)) if margins else 0
    rooms = [each.error / each.unit for each in found if each.unit]
    outcome = Outcome.PASSED if not margins or margins[at] <= 1.0 else Outcome.SILENT
    text = f"{name}: error {found[at].error:.2g}, bound {found[at].bound:.2g}" if found else name
    return _Verdict(outcome, margins[at] if margins else 0.0, max(rooms) if rooms else None, text)
