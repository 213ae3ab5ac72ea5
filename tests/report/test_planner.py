"""What the report says of the planner: what was left out, within its tolerance or not, and predicted beside actual cost."""

from pathlib import Path
from typing import Any

import pytest

from prt_bench import records as record_files
from prt_bench.report.html import write_report
from prt_bench.report.leaderboard import flatten
from prt_bench.report.planner import planned

SKIPS = [
    {"name": "channels", "planned": "1", "full": "3", "error": 0.0, "tolerance": 1e-6, "measure": "largest difference",
     "seconds": 12.25, "rays": 0, "bytes": 34_000_000},
    {"name": "gather samples", "planned": "32² texels", "full": "128² texels", "error": 0.0712, "tolerance": 0.05,
     "measure": "relative RMSE", "seconds": 0.31, "rays": -2_500_000, "bytes": -420_000},
]  # fmt: skip
PREDICTED = {
    "gather_rays": 3_100_000,
    "shadow_rays": 2_300_000,
    "disk_bytes": 59e6,
    "memory_bytes": 1e9,
    "seconds": 6.7,
}
ACTUAL = {**PREDICTED, "shadow_rays": 1_400_000, "seconds": 7.35, "traced_before": False, "resumed": True}


@pytest.fixture
def dataset() -> dict[str, Any]:
    steps = [{"what": "channels", "decision": "1", "why": "grey"}]
    return {"hash": "ab" * 32, "plan": steps, "skips": SKIPS, "predicted": PREDICTED, "actual": ACTUAL}


def test_rows_say_what_was_saved_and_what_it_changed(make_record: Any, dataset: dict[str, Any]) -> None:
    (plan,) = planned([make_record(dataset={}), make_record("mean", dataset=dataset), make_record(dataset=dataset)])
    channels, gather = plan["skips"]
    assert (channels["seconds"], channels["rays"], channels["bytes"]) == ("+12", "0", "+34")
    assert (channels["error"], channels["tolerance"], channels["held"]) == ("0", "1e-06", True)
    assert (gather["seconds"], gather["rays"], gather["bytes"]) == ("+0.31", "-2.5", "-0.42")
    assert (gather["error"], gather["tolerance"], gather["held"]) == ("0.071", "0.05", False)
    assert plan["costs"][1] == ("shadow rays", "2.3 M", "1.4 M")
    assert plan["costs"][-1] == ("trace and light", "6.7 s", "7.3 s")
    (remark,) = plan["remarks"]
    assert "interrupted" in remark
    assert len(plan["steps"]) == 1


def test_scenes_and_scenarios_are_told_apart(make_record: Any, dataset: dict[str, Any]) -> None:
    rows = [make_record(dataset=dataset), make_record(scene="room"), make_record(scenario="area", dataset={})]
    found = {(plan["scene"], plan["scenario"]): plan for plan in planned(rows)}
    assert len(found) == 3
    assert found["cornell", "spot"]["skips"]
    assert not found["room", "spot"]["skips"]
    assert not found["cornell", "area"]["costs"]


def test_the_page_shows_them_and_what_is_over_its_tolerance(
    make_record: Any, dataset: dict[str, Any], tmp_path: Path
) -> None:
    record_files.append(tmp_path / "records.jsonl", make_record(dataset=dataset))
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "What was left out, against the full simulation" in page
    assert "<td>0.071 (over)</td>" in page
    assert "<td>0</td><td>1e-06</td>" in page
    assert "<td>shadow rays</td><td>2.3 M</td><td>1.4 M</td>" in page
    assert page.count("(over)") == 1


def test_records_of_before_show_neither(make_record: Any, tmp_path: Path) -> None:
    record_files.append(tmp_path / "records.jsonl", make_record())
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "What the planner decided" in page
    assert "What was left out" not in page
    assert "Predicted and actual cost" not in page


def test_tables_take_the_costs_and_leave_the_list(make_record: Any, dataset: dict[str, Any]) -> None:
    flat = flatten(make_record(dataset=dataset))
    assert flat["dataset.actual.shadow_rays"] == 1_400_000
    assert not [name for name in flat if "skips" in name]
