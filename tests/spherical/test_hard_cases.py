"""A fast part of the scoreboard's cells and mutants of spherical harmonics; `prt-bench stability --mutations` runs them all."""

import pytest

from prt_bench.stability.cases import cases
from prt_bench.stability.cell import Kind, run_cell
from prt_bench.stability.mutants import kills, mutants
from prt_bench.stability.routes import F32, F64

FAST = [
    ("harmonics at the poles", Kind.GRADIENT, F32),
    ("rotations where angles lock", Kind.GRADIENT, F64),
    ("delta lights under", Kind.VALUE, F32),
    ("Phong lobes", Kind.VALUE, F32),
    ("Phong lobes", Kind.GRADIENT, F64),
    ("caps from points", Kind.VALUE, F32),
    ("triple products", Kind.VALUE, F64),
]


@pytest.mark.parametrize(("title", "kind", "route"), FAST)
def test_hard_cases_hold(title, kind, route):
    (chosen,) = (case for case in cases() if case.title.startswith(title) and case.kind is kind)
    cell = run_cell(chosen, "spherical", route, most=5)
    assert cell.sound, cell.worst


def test_every_catalogued_case_is_there():
    keys = {case.key for case in cases() if "spherical" in case.subjects()}
    assert keys == {"D1", "D2", "D3", "D4", "D5", "D6"}


QUICK = ("the printed recursion of Phong lobes", "caps by differences of Legendre polynomials")


def test_naive_formulas_are_noticed():
    chosen = [mutant for mutant in mutants() if mutant.name in QUICK]
    assert len(chosen) == len(QUICK)
    assert [kill.name for kill in kills(chosen, progress=False) if not kill.killed] == []
