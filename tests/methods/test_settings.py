"""Methods are found, and settings that cannot be are refused in one sentence."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import ClassVar

import pytest

import prt_bench as prt
from prt_bench.errors import SpecError
from prt_bench.methods import _discover
from prt_bench.methods.mean import Mean

BUILT_IN = {"constant", "mean", "nearest", "projection", "reference", "svd-ridge", "operator-ridge"}


def test_built_in_methods_are_found_and_described():
    found = prt.methods()
    assert set(found) >= BUILT_IN
    for method in found.values():
        assert method.summary
        assert method.citation
        assert method.role in ("method", "floor", "ceiling")


@dataclass(frozen=True)
class Elsewhere(Mean):
    name: ClassVar[str] = "elsewhere"


@dataclass(frozen=True)
class Impostor(Mean):
    name: ClassVar[str] = "svd-ridge"


@pytest.fixture
def plug_in(monkeypatch):
    def register(name):
        entry = EntryPoint(name, f"{__name__}:{name}", "prt_bench.methods")
        monkeypatch.setattr(EntryPoint, "load", lambda _: globals()[name])
        monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [entry])
        monkeypatch.setitem(_discover.__wrapped__.__globals__, "entry_points", lambda group: [entry])
        _discover.cache_clear()

    yield register
    _discover.cache_clear()


def test_methods_of_other_packages_are_found(plug_in):
    plug_in("Elsewhere")
    assert isinstance(prt.method("elsewhere"), Elsewhere)


def test_two_methods_of_one_name_are_refused(plug_in):
    plug_in("Impostor")
    with pytest.raises(SpecError, match="two methods are called 'svd-ridge'"):
        prt.methods()


@pytest.mark.parametrize(
    ("name", "settings", "sentence"),
    [
        ("svd-rigde", {}, "there is no method 'svd-rigde'; did you mean 'svd-ridge'?"),
        ("svd-ridge", {"bassis": 4}, "has no setting 'bassis'; did you mean 'basis'?"),
        ("svd-ridge", {"basis": 0}, "'basis' must be at least 1, not 0"),
        ("svd-ridge", {"basis": 2.5}, "'basis' must be an integer, not 2.5"),
        ("svd-ridge", {"basis": True}, "'basis' must be an integer, not True"),
        ("svd-ridge", {"ridge": -1.0}, "'ridge' must be zero or a positive number, not -1.0"),
        ("svd-ridge", {"ridge": float("nan")}, "'ridge' must be zero or a positive number, not nan"),
        ("svd-ridge", {"ridge": "small"}, "'ridge' must be a number, not 'small'"),
        ("svd-ridge", {"gamma": 0.0}, "'gamma' must be a positive number, not 0.0"),
        ("svd-ridge", {"gamma": float("inf")}, "'gamma' must be a positive number, not inf"),
        ("svd-ridge", {"mean": 1}, "'mean' must be true or false, not 1"),
        ("svd-ridge", {"transfer": "both"}, "'transfer' must be 'shared' or 'per-channel' or 'coupled', not 'both'"),
        ("operator-ridge", {"prior": 1.5}, "'prior' must be from 0 to 1, or 'auto', not 1.5"),
        ("projection", {"basis": -3}, "'basis' must be at least 1, not -3"),
        ("mean", {"basis": 3}, "has no setting 'basis'"),
    ],
)
def test_impossible_settings_are_refused(name, settings, sentence):
    with pytest.raises(SpecError) as refused:
        prt.method(name, **settings)
    assert sentence in str(refused.value)


def test_labels_tell_rows_apart():
    labels = [
        prt.method("svd-ridge").label,
        prt.method("svd-ridge", basis=4).label,
        prt.method("svd-ridge", ridge=1e-2).label,
        prt.method("svd-ridge", mean=False).label,
        prt.method("svd-ridge", transfer="coupled", gamma=2.2).label,
        prt.method("operator-ridge").label,
    ]
    assert labels == [
        "svd-ridge b16",
        "svd-ridge b4",
        "svd-ridge b16 ridge=0.01",
        "svd-ridge b16 mean=False",
        "svd-ridge b16 coupled gamma=2.2",
        "operator-ridge b16",
    ]


def test_an_integer_is_a_number():
    assert prt.method("svd-ridge", ridge=0).ridge == 0
