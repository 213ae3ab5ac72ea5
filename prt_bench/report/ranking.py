"""Which rows are compared with which, in what order, and when two of them cannot be told apart.

A group holds the rows of one (scene, scenario, split) on one device. Ranks are by relative RMSE on held-out lightings.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from prt_bench.records import Record
from prt_bench.report.frontier import METRICS, Row, rows

TIE_RULE = (
    "Two rows are tied when their squared relative errors differ by no more than the squared noise floor, "
    "|e₁² − e₂²| ≤ n²; rows under the noise floor are therefore all tied."
)


@dataclass(frozen=True)
class Entry:
    """A row with its place. `rank` is None for rows that are shown only; `tied` tells that it shares its rank."""

    row: Row
    rank: int | None
    tied: bool

    @property
    def place(self) -> str:
        """The rank as printed: `2`, `2=` for a shared one, `–` for none."""
        return "–" if self.rank is None else f"{self.rank}{'=' if self.tied else ''}"


@dataclass(frozen=True)
class Group:
    """Entries of one (scene, scenario, split) on one device, best first, then the rows that are shown only."""

    scene: str
    scenario: str
    split: str
    device: str
    noise_floor: float | None
    entries: tuple[Entry, ...]

    @property
    def title(self) -> str:
        """The group's name without its device."""
        return f"{self.scene} · {self.scenario} · {self.split}"


def tied(a: Row, b: Row) -> bool:
    """Whether noise could explain the difference of two rows' relative RMSE.

    The reference is itself an estimate, off by its noise floor n, and errors add in squares: a measured e² is known
    to ± n². So two rows are told apart only by |e_a² − e_b²| > n² (n: the larger of their two noise floors; none
    measured counts as 0).
    """
    errors = [METRICS["relative_rmse"].of(row) for row in (a, b)]
    if errors[0] is None or errors[1] is None:
        return False
    noise = max(row.record.errors.noise_floor or 0.0 for row in (a, b))
    return abs(errors[0] ** 2 - errors[1] ** 2) <= noise**2


def rank(group: Sequence[Row]) -> list[Entry]:
    """Order the rows of one group. A row shares the rank of the best row it is tied with; ranks after a tie skip ahead.

    Ties are with the best row of a rank, not with the nearest neighbour, so that chains of small steps stay apart.
    """
    error = METRICS["relative_rmse"]
    ranked = sorted(
        (row for row in group if row.rankable and error.of(row) is not None),
        key=lambda row: (error.of(row), row.record.label),
    )
    shown = sorted(
        (row for row in group if row not in ranked),
        key=lambda row: (row.record.status in ("failed", "timeout"), error.of(row) or 0.0, row.record.label),
    )
    ranks: list[int] = []
    leader = 0
    for index, row in enumerate(ranked):
        if index and not tied(ranked[leader], row):
            leader = index
        ranks.append(leader + 1)
    entries = [Entry(row, place, ranks.count(place) > 1) for row, place in zip(ranked, ranks, strict=True)]
    return entries + [Entry(row, None, False) for row in shown]


def groups(records: Iterable[Record]) -> list[Group]:
    """All groups, in the order of the records.

    Rows that do not compete (oracles, ceilings, failures) are shown beside every device of their scene and split.
    """
    runs: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows(records):
        runs.setdefault((row.record.scene, row.record.scenario, row.record.split), []).append(row)
    found = []
    for key, members in runs.items():
        devices = dict.fromkeys(row.device for row in members if row.rankable) or {"not timed": None}
        for device in devices:
            chosen = [row for row in members if row.device == device or not row.rankable]
            floors = [row.record.errors.noise_floor for row in chosen]
            noise = max((floor for floor in floors if floor is not None), default=None)
            found.append(Group(*key, device, noise, tuple(rank(chosen))))
    return found
