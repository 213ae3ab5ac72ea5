"""Metrics of a row, and the frontier of error against cost."""

import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from prt_bench.records import Errors
from prt_bench.report.frontier import COST_AXES, ERROR_AXES, METRICS, frontier, pareto, rows
from prt_bench.report.ranking import groups, rank, tied

# Few distinct values, so that equal points and equal coordinates are common.
POINTS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=40)


def dominates(a, b):
    return a[0] <= b[0] and a[1] <= b[1] and a != b


@given(POINTS)
def test_pareto_equals_brute_force(points):
    expected = {i for i, point in enumerate(points) if not any(dominates(other, point) for other in points)}
    found = pareto(points)
    assert set(found) == expected
    assert len(found) == len(expected)
    assert [points[i] for i in found] == sorted(points[i] for i in found)


def test_frontier_follows_each_metrics_direction(make_record):
    group = rows(
        [make_record("svd-ridge b4", 0.1, 4), make_record("svd-ridge b8", 0.05, 8), make_record("nearest", 0.2, 128)]
    )
    assert frontier(group, METRICS["frame_ms"], METRICS["relative_rmse"]) == [0, 1]
    assert frontier(group, METRICS["frame_ms"], METRICS["psnr"]) == [0, 1]
    assert frontier(group, METRICS["frame_ms"], METRICS["ssim"]) == [0, 1]


def test_frontier_refuses_rows_of_two_renderers(make_record, make_timings):
    group = rows([make_record(), make_record(timings=make_timings(16, device="Fast GPU", speed=0.01))])
    with pytest.raises(ValueError, match="different devices"):
        frontier(group, METRICS["frame_ms"], METRICS["relative_rmse"])


def test_groups_never_mix_devices(records, make_timings):
    fast = [
        type(record)(**{**vars(record), "timings": make_timings(8, "Fast GPU", 0.01)})
        for record in records
        if record.status == "ok"
    ]
    board = groups([*records, *fast])
    assert len(board) == 2 * len(groups(records))
    for group in board:
        assert {entry.row.device for entry in group.entries if entry.rank is not None} == {group.device}
    assert {group.device.split(" · ")[0] for group in board} == {"Fast GPU", "llvmpipe (LLVM 15.0.6, 256 bits)"}


def test_two_clocks_of_one_device_are_never_ranked_together(make_record, make_timings):
    wall, jax = make_timings(16)
    record = make_record(timings=(wall, replace(wall, clock="timer-query"), jax))
    assert [len(group.entries) for group in groups([record, replace(record, label="b")])] == [2, 2]


@pytest.mark.parametrize("change", ["host", "resolution", "no OpenGL"])
def test_other_hosts_and_resolutions_and_jax_alone_are_other_devices(make_record, make_timings, change):
    other = {
        "host": {"provenance": {"cpu": "Other CPU", "cores": 64}},
        "resolution": {"timings": make_timings(16, resolution=(1920, 1080))},
        "no OpenGL": {"timings": make_timings(16, gl=False), "status": "no-gl", "reason": "no EGL"},
    }[change]
    assert len(groups([make_record(), make_record("svd-ridge b8", **other)])) == 2


def test_unranked_rows_are_shown_beside_every_device_and_on_no_frontier(records):
    for group in groups(records):
        by_label = {entry.row.record.label: entry for entry in group.entries}
        assert {"projection", "reference", "mlp-large"} <= set(by_label)
        assert all(by_label[label].rank is None for label in ("projection", "reference", "mlp-large"))
        members = [entry.row for entry in group.entries]
        for x in COST_AXES:
            for y in ERROR_AXES:
                assert all(members[i].rankable for i in frontier(members, METRICS[x], METRICS[y]))


def test_missing_and_infinite_figures_are_none(make_record):
    (row,) = rows([make_record("x", None, timings=(), bytes={}, seconds={})])
    assert all(metric.of(row) is None for metric in METRICS.values())
    (row,) = rows([make_record(errors=Errors(relative_rmse=float("inf"), psnr=float("nan")))])
    assert METRICS["relative_rmse"].of(row) is METRICS["psnr"].of(row) is None


def test_indirect_cost_is_the_frame_less_its_baseline(make_record):
    (row,) = rows([make_record()])
    assert METRICS["indirect_ms"].of(row) == pytest.approx(row.gl.stages["frame"].median - row.gl.baseline.median)
    assert METRICS["prepare_s"].of(row) == pytest.approx(12.5 + 0.32)


def test_a_later_record_replaces_its_predecessor(make_record):
    found = rows([make_record(error=0.5), make_record(error=0.1)])
    assert [METRICS["relative_rmse"].of(row) for row in found] == [0.1]


def noisy(make_record, errors, noise):
    return rows(
        make_record(f"m{i}", errors=Errors(relative_rmse=error, noise_floor=noise)) for i, error in enumerate(errors)
    )


def test_ties_are_differences_in_squares_within_the_noise_floor(make_record):
    a, b, c = noisy(make_record, [0.003, 0.0099, 0.0140], 0.01)
    assert tied(a, b), "rows under the noise floor are tied"
    assert not tied(a, c)
    assert tied(b, c), "0.0140² − 0.0099² < 0.01²"
    far = noisy(make_record, [0.1, 0.101], 0.01)
    assert not tied(*far), "far above the floor, a difference of a tenth of it in error is one of twice in squares"
    assert tied(*noisy(make_record, [0.2, 0.2], None))
    assert not tied(*noisy(make_record, [0.2, 0.2000001], None)), "without a noise floor only equals are tied"


def test_ranks_share_the_leaders_place_and_skip_after_a_tie(make_record):
    entries = rank(noisy(make_record, [0.03, 0.0140, 0.0099, 0.003], 0.01))
    assert [entry.row.record.label for entry in entries] == ["m3", "m2", "m1", "m0"]
    assert [entry.place for entry in entries] == ["1=", "1=", "3", "4"], (
        "m1 is tied with m2, but not with the leader m3"
    )


def test_order_of_records_does_not_change_ranks(records):
    shuffled = random.Random(0).sample(records, len(records))
    places = [
        {(g.title, g.device, e.row.record.label): e.place for g in groups(found) for e in g.entries}
        for found in (records, shuffled)
    ]
    assert places[0] == places[1]
