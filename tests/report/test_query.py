"""`compare` and `best` answer from records."""

import io

import pytest
from rich.console import Console

from prt_bench import records as record_files
from prt_bench.errors import SpecError
from prt_bench.records import Errors
from prt_bench.report.frontier import METRICS
from prt_bench.report.query import best, best_table, compare, compare_table, parse_budget


def shown(table):
    terminal = Console(width=200, record=True, file=io.StringIO())
    terminal.print(table)
    return terminal.export_text()


def test_compare_gives_ratios_per_scene_and_split(records):
    found = compare(records, "svd-ridge b8", "svd-ridge b16")
    assert [(c.group.scene, c.group.split) for c in found] == [
        ("cornell", "test"), ("cornell", "ood-environment"), ("suzanne", "test"), ("suzanne", "ood-environment"),
    ]  # fmt: skip
    first = found[0]
    assert first.error == pytest.approx((0.012 + 0.45 / 8) / (0.012 + 0.45 / 16))
    assert first.bytes == pytest.approx(0.5)
    assert first.time == pytest.approx(METRICS["frame_ms"].of(first.a) / METRICS["frame_ms"].of(first.b))
    assert not first.tied


def test_compare_by_method_takes_its_most_accurate_row(records):
    found = compare(records, "operator-ridge", "svd-ridge")
    assert {(c.a.record.label, c.b.record.label) for c in found} == {("operator-ridge b64", "svd-ridge b64")}
    assert found[0].tied, "0.0190² − 0.0153² is under the squared noise floor"


def test_compare_never_crosses_devices(make_record, make_timings):
    there = make_timings(16, device="Fast GPU", speed=0.01)
    with pytest.raises(SpecError, match="never ran on the same"):
        compare([make_record("a"), make_record("b", timings=there)], "a", "b")


def test_compare_times_by_jax_where_a_row_has_no_frame(make_record):
    oracle = make_record(
        "projection", 0.01, 64, status="oracle", reason="r", timings=make_record("x", 0.1, 64).timings[1:]
    )
    (found,) = compare([make_record(), oracle], "projection", "svd-ridge b16")
    assert found.time == pytest.approx(METRICS["jax_ms"].of(found.a) / METRICS["jax_ms"].of(found.b))


def test_unknown_names_suggest_the_nearest(records):
    with pytest.raises(SpecError, match="nearest is 'svd-ridge'"):
        compare(records, "svdridge", "mean")


@pytest.mark.parametrize(
    ("text", "metric", "limit"),
    [
        ("0.5ms", "indirect_ms", 0.5), (" 500 us ", "indirect_ms", 0.5), ("500µs", "indirect_ms", 0.5),
        (".5ms", "indirect_ms", 0.5),
        ("2MB", "runtime_bytes", 2e6), ("2 MiB", "runtime_bytes", 2.0**21), ("1e3kB", "runtime_bytes", 1e6),
        ("10s", "prepare_s", 10), ("2min", "prepare_s", 120),
    ],
)  # fmt: skip
def test_budgets(text, metric, limit):
    budget = parse_budget(text)
    assert budget.metric.name == metric
    assert budget.limit == pytest.approx(limit)


@pytest.mark.parametrize("text", ["", "5", "ms", "-1ms", "5 parsecs", "1.2.3ms", "nan ms", "5ms5"])
def test_unreadable_budgets_are_one_sentence(text):
    with pytest.raises(SpecError, match=r"write 0\.5ms, 2MB or 10s"):
        parse_budget(text)


def test_best_is_the_most_accurate_that_fits_by_brute_force(records):
    for within, name, limit in (("3ms", "indirect_ms", 3.0), ("2MB", "runtime_bytes", 2e6), ("13s", "prepare_s", 13.0)):
        for answer in best(records, within):
            fitting = [
                entry.row for entry in answer.group.entries
                if entry.rank is not None and METRICS[name].of(entry.row) <= limit
            ]  # fmt: skip
            assert answer.rows[0].record.errors.relative_rmse == min(r.record.errors.relative_rmse for r in fitting)
            assert set(answer.rows) <= set(fitting)


def test_best_lists_all_that_are_tied(make_record):
    near = [
        make_record(f"m{i}", errors=Errors(relative_rmse=e, noise_floor=0.01))
        for i, e in enumerate((0.02, 0.021, 0.03))
    ]
    (answer,) = best(near, "20ms")
    assert [row.record.label for row in answer.rows] == ["m0", "m1"]


def test_best_says_so_when_nothing_fits(records):
    for answer in best(records, "1us"):
        assert answer.rows == ()
        assert answer.cheapest.record.label == "constant"


def test_oracles_are_never_the_best(records):
    labels = {row.record.label for answer in best(records, "1000s") for row in answer.rows}
    assert labels
    assert not labels & {"projection", "reference", "mlp-large"}


def test_tables(tmp_path, records):
    for record in records:
        record_files.append(tmp_path / "records.jsonl", record)
    text = shown(compare_table(tmp_path, "operator-ridge", "svd-ridge b4"))
    assert "operator-ridge b64 over svd-ridge b4" in text
    assert "cornell · spot · test" in text
    text = shown(best_table(tmp_path / "records.jsonl", "3ms"))
    assert "operator-ridge b8" in text
    assert "2.62 ms" in text
    assert "nothing fits; the cheapest is constant at 1.15 ms" in shown(best_table(tmp_path, "1us"))
