"""A fast part of the scoreboard, and of the mutants: `prt-bench stability --mutations` runs all of both."""

import operator
from importlib import import_module

import pytest

from prt_bench.stability.board import HEADROOM
from prt_bench.stability.cases import cases
from prt_bench.stability.cell import Kind, run_cell
from prt_bench.stability.mutants import kills, mutants
from prt_bench.stability.routes import F32, F64

FAST = [
    ("A2", Kind.VALUE, "ridge", F64),
    ("A1", Kind.VALUE, "ridge", F32),
    ("A12", Kind.VALUE, "leave_one_out", F64),
    ("H1", Kind.GRADIENT, "ridge", F64),
    ("B1", Kind.VALUE, "leading_basis", F64),
    ("B2", Kind.VALUE, "leading_basis", F32),
    ("B4", Kind.REFUSAL, "cut_gap", F64),
    ("C5", Kind.GRADIENT, "safe_norm", F32),
    ("F2", Kind.VALUE, "gather", F32),
    ("G5", Kind.VALUE, "embree", F32),
    ("G5", Kind.VALUE, "unwrap", F64),
    ("C5", Kind.VALUE, "repaired", F64),
    ("G4", Kind.VALUE, "PointLight", F32),
    ("F4", Kind.VALUE, "fibre", F32),
    ("F4", Kind.GRADIENT, "fibre", F32),
    ("F4", Kind.REFUSAL, "strands", F64),
    ("B9", Kind.VALUE, "float16", F64),
    ("A6", Kind.REFUSAL, "svd-ridge b6", F64),
    ("H1", Kind.GRADIENT, "streamed-ridge b6 ridge=0.03", F64),
]


@pytest.mark.parametrize(("key", "kind", "subject", "route"), FAST, ids=lambda part: getattr(part, "name", str(part)))
def test_hard_cases_hold(key, kind, subject, route):
    judged = [
        run_cell(case, subject, route, most=3 if subject.startswith("streamed-ridge") else 10)  # slow to differentiate
        for case in cases()
        if case.key == key and case.kind == kind and route in case.routes and subject in case.subjects()
    ]
    assert judged
    assert not [cell for cell in judged if not cell.sound or (cell.headroom or 0.0) > HEADROOM]


QUICK = (
    "the printed ridge, transposes mixed",
    "norm with NaN gradient at zero",
    "norm of unscaled squares",
    "gaps unseen",
    "lights unchecked",
    "strands unchecked",
    "back faces reflect",
    "texture coordinates as they come",
    "bad pixels kept",
    "8-bit bases of one global range",
)


def test_naive_formulas_are_noticed():
    chosen = [mutant for mutant in mutants() if mutant.name in QUICK]
    assert len(chosen) == len(QUICK)
    assert [kill.name for kill in kills(chosen, progress=False) if not kill.killed] == []


def test_there_are_many_mutants_and_the_cases_they_name_exist():
    assert len(mutants()) >= 25
    titles = [case.title for case in cases()]
    assert not [
        each.name for each in mutants() for start in each.titles if not any(t.startswith(start) for t in titles)
    ]


def test_what_mutants_replace_exists():
    for each in mutants():
        module, _, path = each.replaces.partition(":")
        assert operator.attrgetter(path)(import_module(module)), each.name


def test_a_sound_formula_is_no_kill():
    """The harness itself: what changes nothing is noticed by nobody."""
    (gapless,) = (each for each in mutants() if each.name == "gaps unseen")
    harmless = type(gapless)("harmless", gapless.replaces, lambda sound: lambda *a: sound(*a), gapless.titles)
    assert not kills([harmless], progress=False)[0].killed
