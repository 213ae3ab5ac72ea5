"""How cells are judged and added up, and that the scoreboard's own references are right."""

import json
import warnings

import numpy as np
import pytest

from prt_bench.cli import main
from prt_bench.errors import FitError, SpecError
from prt_bench.stability import board, exact
from prt_bench.stability.cases import cases
from prt_bench.stability.cell import Case, Kind, Measured, Member, Outcome, run_cell
from prt_bench.stability.journal import Journal
from prt_bench.stability.mutants import kills, mutants
from prt_bench.stability.nist import regressions
from prt_bench.stability.rigs import BASIS, settings, subjects
from prt_bench.stability.routes import BF16, F16, F32, F64


def cell_of(check, members=("a",), kind=Kind.VALUE, ill_posed=False):
    family = [Member(name, name, ill_posed) for name in members]
    return run_cell(Case("X", "x", kind, lambda: {"s": None}, lambda route: family, check, (F64,)), "s", F64)


def refuses(*_):
    raise FitError("no")


def warns(*_):
    warnings.warn("arbitrary", stacklevel=2)
    return [Measured(0.0, 1.0)]


@pytest.mark.parametrize(
    ("check", "kind", "ill_posed", "outcome"),
    [
        (lambda *_: [Measured(0.5, 1.0)], Kind.VALUE, False, Outcome.PASSED),
        (lambda *_: [Measured(0.5, 1.0), Measured(2.0, 1.0)], Kind.VALUE, False, Outcome.SILENT),
        (lambda *_: [Measured(1e-300, 0.0)], Kind.VALUE, False, Outcome.SILENT),
        (lambda *_: [Measured(0.0, 0.0)], Kind.VALUE, False, Outcome.PASSED),
        (lambda *_: [Measured(np.nan, 1.0)], Kind.GRADIENT, False, Outcome.LOUD),
        (lambda *_: 1 / 0, Kind.VALUE, False, Outcome.LOUD),
        (refuses, Kind.VALUE, False, Outcome.LOUD),
        (refuses, Kind.VALUE, True, Outcome.REFUSED),
        (refuses, Kind.REFUSAL, False, Outcome.REFUSED),
        (warns, Kind.REFUSAL, False, Outcome.REFUSED),
        (lambda *_: True, Kind.REFUSAL, False, Outcome.REFUSED),
        (lambda *_: False, Kind.REFUSAL, False, Outcome.SILENT),
        (lambda *_: [Measured(0.0, 1.0)], Kind.VALUE, True, Outcome.SILENT),
    ],
)
def test_a_cell_is_judged_by_what_it_answers(check, kind, ill_posed, outcome):
    """A refusal of what has an answer is a failure; an answer to what has none is a silent one."""
    assert cell_of(check, kind=kind, ill_posed=ill_posed).outcome == outcome


def test_a_cell_is_as_bad_as_its_worst_member():
    cell = cell_of(lambda _, name, __: [Measured(float(len(name)), 2.0, 0.5)], ("a", "abc", "ab"))
    assert (cell.outcome, cell.headroom, cell.members) == (Outcome.SILENT, 6.0, 3)
    assert cell.worst.startswith("abc")


def test_goals_name_what_stands_against_them():
    sound, silent = (cell_of(lambda _, __, ___, e=e: [Measured(e, 1.0, 0.04)]) for e in (0.5, 2.0))
    found = {goal.name: goal for goal in board.goals([sound, silent], [board.Kill("naive", "m:f", ())])}
    assert {name for name, goal in found.items() if not goal.met} == set(found)
    assert found["silent failures"].missed == (silent.name,)
    assert found["mutants killed"].missed == ("naive",)
    assert all(goal.met for goal in board.goals([cell_of(lambda *_: [Measured(0.1, 1.0, 0.5)])]))


def test_every_topic_of_the_catalogue_is_found():
    assert len(cases()) == len({(case.key, case.title, case.kind) for case in cases()})
    keys = "A0 A1 A1b A2 A3 A5 A6 A7 A8 A11 A12 A13 B1 B2 B3 B4 B5 B7 B9 C4 C5 D7 F1 F2 F3 F4 G3 G4 G5 H1 H3"
    assert set(keys.split()) <= {case.key for case in cases()}
    with pytest.raises(SpecError, match="no case 'Z9'"):
        board.selected(["Z9"])


def test_methods_and_their_variants_join_by_being_discovered():
    found = subjects()
    assert {"svd-ridge b6", "operator-ridge b6", "nearest", "mean"} <= found.keys()
    assert any(settings(method).get("mean") is False for method in found.values())
    assert all(settings(method).get("basis", BASIS) == BASIS for method in found.values())


def test_routes_round_as_their_dtypes_do():
    values = np.array([1.0, 1 / 3, 1e5, 1e-9])
    assert F64.arrive(values).tolist() == values.tolist()
    assert F32.arrive(values).dtype == F16.arrive(values).dtype == BF16.arrive(values).dtype == np.float32
    assert np.isinf(F16.arrive(values)[2])
    assert abs(BF16.arrive(values)[1] - 1 / 3) > 1e-4 > abs(F16.arrive(values)[1] - 1 / 3)


def test_the_exact_solver_reproduces_the_certified_regressions():
    """The reference against NIST's values, and both against the textbook on easy data."""
    for regression in regressions().values():
        found = exact.ridge(regression.design, regression.response, 0.0)[0]
        np.testing.assert_allclose(found, regression.certified, rtol=1e-7)
    rng = np.random.default_rng(0)
    x, c = rng.normal(size=(9, 5)), rng.normal(size=(2, 5))
    np.testing.assert_allclose(exact.ridge(x, c, 0.3), c @ x.T @ np.linalg.inv(x @ x.T + 0.3 * np.eye(9)), rtol=1e-12)
    held = np.eye(5) - np.linalg.solve(x.T @ x + 0.3 * np.eye(5), x.T @ x)
    np.testing.assert_allclose(exact.leave_one_out(x, c, 0.3), (c @ held) / np.diagonal(held), rtol=1e-12)


def test_the_command_prints_writes_and_says_whether_goals_are_met(tmp_path, capsys):
    assert main(["stability", "--case", "A1", "--route", "f64", "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "coincident measurement points" in told
    assert "met" in told
    written = json.loads((tmp_path / "stability.json").read_text())
    assert {cell["case"] for cell in written["cells"]} == {"A1"}
    assert all(goal["met"] for goal in written["goals"])


def test_a_missed_goal_is_the_exit_status(monkeypatch, tmp_path):
    bad = Case(
        "X", "x", Kind.VALUE, lambda: {"s": None}, lambda _: [Member("m", 0)], lambda *_: [Measured(2, 1)], (F64,)
    )
    monkeypatch.setattr(board, "cases", lambda: (bad,))
    assert main(["stability"]) == 1


def test_an_output_that_cannot_be_written_is_refused_before_the_work(capsys):
    assert main(["stability", "--out", "/nowhere/at/all.json"]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_cells_and_mutants_are_the_same_in_other_processes():
    chosen = board.selected(["A1b"])
    assert board.run(chosen, ["f64"], progress=False, jobs=2) == board.run(chosen, ["f64"], progress=False)
    naive = [each for each in mutants() if each.name == "norm of unscaled squares"]
    assert kills(naive, progress=False, jobs=2) == kills(naive, progress=False)
    with pytest.raises(SpecError, match="at least 1 job"):
        board.run(chosen, progress=False, jobs=0)


def test_an_interrupted_scoreboard_goes_on(tmp_path, monkeypatch):
    chosen, file = board.selected(["A1b"]), tmp_path / "cells"
    whole = board.run(chosen, ["f64"], progress=False, journal=Journal(file))
    kept = file.read_text().splitlines()
    assert len(kept) == 1 + len(whole)
    file.write_text("\n".join(kept)[:-20])  # cut off in the last cell
    judged = []
    monkeypatch.setattr(board, "run_cell", lambda *cell: judged.append(cell[1]) or run_cell(*cell))
    assert board.run(chosen, ["f64"], progress=False, journal=Journal(file)) == whole
    assert judged == [whole[-1].subject]
    file.write_text("\n".join([json.dumps({"code": "other"}), *kept[1:]]))
    assert not Journal(file).cells
