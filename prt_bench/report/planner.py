"""What the report says of the planner, from records alone: decisions, what they left out, and predicted and actual cost."""

from collections.abc import Iterable, Mapping
from typing import Any

from prt_bench.records import Record

COSTS = (
    ("gather_rays", "gather rays", 1e6, "M"),
    ("shadow_rays", "shadow rays", 1e6, "M"),
    ("disk_bytes", "on disk", 1e6, "MB"),
    ("memory_bytes", "peak memory of the process", 1e6, "MB"),
    ("seconds", "trace and light", 1.0, "s"),
)


def planned(records: Iterable[Record]) -> list[dict[str, Any]]:
    """Per scene and scenario, of the first record that says so: decisions, what they left out, costs and their remarks."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for record in records:
        entry = found.setdefault(
            (record.scene, record.scenario),
            {"scene": record.scene, "scenario": record.scenario, "steps": [], "skips": [], "costs": [], "remarks": []},
        )
        entry["steps"] = entry["steps"] or record.dataset.get("plan") or []
        entry["skips"] = entry["skips"] or [_skip(skip) for skip in record.dataset.get("skips") or []]
        if not entry["costs"] and "actual" in record.dataset:
            entry["costs"] = costs(record.dataset["predicted"], record.dataset["actual"])
            entry["remarks"] = _remarks(record.dataset["actual"])
    return list(found.values())


def costs(predicted: Mapping[str, float], actual: Mapping[str, float]) -> list[tuple[str, str, str]]:
    """What a bake was to cost and what it did: name, predicted, actual."""
    return [
        (label, f"{predicted[name] / scale:.1f} {unit}", f"{actual[name] / scale:.1f} {unit}")
        for name, label, scale, unit in COSTS
        if name in predicted and name in actual
    ]


def _remarks(actual: Mapping[str, Any]) -> list[str]:
    known = {
        "traced_before": "The rays of the scene had been traced before.",
        "resumed": "An interrupted bake was gone on with: actual rays and seconds are those since.",
    }
    return [text for name, text in known.items() if actual.get(name)]


def _skip(skip: Mapping[str, Any]) -> dict[str, Any]:
    """One row of what was left out, as text."""
    return {
        **{name: skip[name] for name in ("name", "planned", "full", "measure")},
        "error": f"{skip['error']:.2g}",
        "tolerance": f"{skip['tolerance']:g}",
        "held": skip["error"] <= skip["tolerance"],
        "seconds": _signed(skip["seconds"]),
        "rays": _signed(skip["rays"] / 1e6),
        "bytes": _signed(skip["bytes"] / 1e6),
    }


def _signed(value: float) -> str:
    return "0" if value == 0 else f"{value:+.2g}" if abs(value) < 10 else f"{value:+.0f}"
