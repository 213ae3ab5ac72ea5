"""A fast part of what training must survive; `prt-bench stability --case E1 E2 E3` runs all of it."""

import pytest

from prt_bench.stability.cases import cases
from prt_bench.stability.cell import run_cell
from prt_bench.stability.mutants import kills, mutants
from prt_bench.stability.routes import F32


@pytest.mark.parametrize("key", ["E1", "E2", "E3"])
def test_hard_cases_hold(key):
    chosen = [(case, subject) for case in cases() if case.key == key for subject in case.subjects()]
    assert chosen
    assert not [cell for cell in (run_cell(case, subject, F32, most=2) for case, subject in chosen) if not cell.sound]


def test_a_loss_without_a_floor_is_noticed():
    chosen = [mutant for mutant in mutants() if mutant.name == "a relative loss without a floor"]
    assert [kill.killed for kill in kills(chosen, progress=False)] == [True]
