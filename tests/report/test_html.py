"""The report is one offline page that holds every row and shows them honestly."""

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from prt_bench import records as record_files
from prt_bench.errors import DatasetError
from prt_bench.report.embed import LEVELS, Pair, embed, encode_difference, encode_reference, shrink
from prt_bench.report.html import write_report
from prt_bench.report.pictures import read_picture, write_picture

SCRIPT = '<script>alert("x")</script><img src=//evil.example/x.png>'


class Page(HTMLParser):
    """The tags of a page with their attributes, and the text of its data script."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, text):
        if self.tags and self.tags[-1][0] == "script":
            self.scripts.append((self.tags[-1][1].get("id"), text))

    @property
    def data(self):
        return json.loads(next(text for name, text in self.scripts if name == "data"))


@pytest.fixture(scope="module")
def page(run_dir):
    return write_report(run_dir).read_text(encoding="utf-8")


def test_the_page_loads_nothing_and_says_so_to_the_browser(page):
    tags = Page(page).tags
    loads = [
        attributes[name]
        for _, attributes in tags
        for name in ("src", "href", "srcset", "data", "action")
        if name in attributes
    ]
    assert all(value.startswith("data:") for value in loads)
    assert not [tag for tag, _ in tags if tag in ("link", "iframe", "object", "embed", "base")]
    policy = next(a["content"] for tag, a in tags if tag == "meta" and a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    style = page[page.index("<style>") : page.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_plotly_is_embedded_once_and_the_page_stays_small(page):
    assert len(re.findall(r"plotly\.js v\d", page)) == 1
    assert len(page.encode()) < 15_000_000


def test_a_malicious_name_stays_text(tmp_path, make_record):
    names = {"scene": SCRIPT, "label": SCRIPT, "method": SCRIPT, "status": "failed", "reason": SCRIPT}
    dataset = {"plan": [{"what": SCRIPT, "decision": SCRIPT, "why": SCRIPT}], "hash": SCRIPT}
    record_files.append(tmp_path / "records.jsonl", make_record(**names, dataset=dataset, provenance={"cpu": SCRIPT}))
    page = write_report(tmp_path).read_text(encoding="utf-8")
    parsed = Page(page)
    assert "evil.example" in page
    assert not [tag for tag, attributes in parsed.tags if tag == "img" or "evil" in str(attributes.get("src"))]
    assert 'alert("x")' not in "".join(text for _, text in parsed.scripts)
    assert parsed.data["groups"][0]["scene"] == SCRIPT


def test_default_axes_are_relative_rmse_against_frame_time(page):
    data = Page(page).data
    assert (data["axes"]["x"][0], data["axes"]["y"][0]) == ("frame_ms", "relative_rmse")


def test_every_row_is_in_the_table_and_the_data(run_dir, page):
    records = record_files.read(run_dir / "records.jsonl")
    data = Page(page).data
    assert sum(len(group["rows"]) for group in data["groups"]) == len(records)
    assert page.count('class="ranked"') + page.count('class="shown"') == len(records)


def test_reasons_stand_below_their_table_once_for_all_rows_that_share_them(page):
    groups = len(Page(page).data["groups"])
    assert page.count("<b>timeout</b> (mlp-large): the fit took over 60 s.") == groups
    assert page.count("the fit took over 60 s.") == groups
    assert page.count('">timeout</td>') == groups
    assert page.count("<b>oracle</b> (projection): needs the reference at run time.") == groups


def test_frontiers_name_undominated_ranked_rows(page):
    for group in Page(page).data["groups"]:
        for name, indices in group["frontiers"].items():
            x, _ = name.split()
            costs = [group["rows"][i]["values"][x] for i in indices]
            assert costs == sorted(costs)
            assert all(group["rows"][i]["place"] != "–" for i in indices)


def test_plan_hashes_and_provenance_are_shown(page):
    for text in ("the Neumann tail after 9 bounces", "9f2c" * 16, "Example CPU", "0123456789ab", "ab" * 32):
        assert text in page


def test_a_run_without_pictures_and_timings_still_reports(tmp_path, make_record):
    record_files.append(tmp_path / "records.jsonl", make_record(timings=(), bytes={}, curves={}, dataset={}, asset={}))
    assert write_report(tmp_path).stat().st_size > 1_000_000


@pytest.mark.parametrize("path", ["pictures/gone.exr", "../outside.exr"])
def test_missing_or_outside_pictures_are_one_sentence(tmp_path, make_record, path):
    write_picture(tmp_path / "outside.exr", np.ones((2, 2, 3), np.float32))
    (tmp_path / "run").mkdir()
    record = make_record(pictures={"prediction": path, "reference": path})
    record_files.append(tmp_path / "run" / "records.jsonl", record)
    with pytest.raises(DatasetError, match="not in that folder"):
        write_report(tmp_path / "run")
    assert not (tmp_path / "run" / "report.html").exists()


def test_pictures_survive_their_file_to_half_precision(tmp_path):
    image = np.random.default_rng(0).lognormal(0, 3, (7, 5, 3)).astype(np.float32)
    np.testing.assert_array_equal(
        read_picture(write_picture(tmp_path / "a" / "b.exr", image)), image.astype(np.float16)
    )


def test_bad_pictures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="NaN"):
        write_picture(tmp_path / "a.exr", np.full((2, 2, 3), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"\[H, W, 3\]"):
        write_picture(tmp_path / "a.exr", np.ones((2, 2), np.float32))
    (tmp_path / "a.exr").write_bytes(b"not an EXR")
    with pytest.raises(DatasetError, match="cannot be read"):
        read_picture(tmp_path / "a.exr")


def planes(encoded, count):
    raw = np.frombuffer(zlib.decompress(base64.b64decode(encoded.data)), np.uint8)
    return raw.reshape(count, 3, encoded.height, encoded.width).astype(np.int64)


def decode_reference(encoded):
    """What the page's script does, in other words."""
    high, low = planes(encoded, 2)
    bits = np.cumsum(high << 8 | low, axis=2).astype(np.uint16) << 3
    return np.moveaxis(bits.astype(np.uint16).view(np.float16), 0, 2).astype(np.float64)


def decode_difference(encoded):
    levels = np.cumsum(planes(encoded, 1)[0], axis=2).astype(np.int8).astype(np.float64)
    return np.moveaxis(encoded.peak * np.sign(levels) * (levels / LEVELS) ** 2, 0, 2)


def test_embedded_references_keep_seven_bits():
    image = np.random.default_rng(1).lognormal(0, 2, (31, 47, 3)).astype(np.float32)
    np.testing.assert_allclose(decode_reference(encode_reference(image)), image, rtol=2.0**-8 + 2.0**-11)


def test_embedded_differences_are_right_to_three_percent_of_the_largest():
    error = np.random.default_rng(2).standard_normal((31, 47, 3)) ** 3
    found = decode_difference(encode_difference(error))
    peak = np.abs(error).max()
    assert np.abs(found - error).max() <= peak / LEVELS
    assert np.abs(found - error).max() > 0
    small = np.abs(error) < 0.01 * peak
    assert np.abs(found - error)[small].max() < 0.005 * peak, "small errors keep finer steps"


def test_a_perfect_prediction_has_no_difference():
    assert not decode_difference(encode_difference(np.zeros((4, 4, 3)))).any()


def test_shrinking_keeps_the_mean():
    image = np.random.default_rng(3).random((40, 60, 3)).astype(np.float32)
    assert shrink(image, 60) is image
    small = shrink(image, 20)
    assert small.shape == (13, 20, 3)
    np.testing.assert_allclose(small.mean(), image.mean(), rtol=1e-6)
    np.testing.assert_allclose(shrink(image, 30), image.reshape(20, 2, 30, 2, 3).mean(axis=(1, 3)), rtol=1e-6)


def rows_of_pictures(folder, count):
    random = np.random.default_rng(4)
    reference = random.random((30, 40, 3)).astype(np.float32)
    pairs = []
    for index in range(count):
        paths = {name: folder / f"{name}-{index}.exr" for name in ("p", "r", "ip", "ir")}
        error = 0.1 * random.random((30, 40, 3))
        for name, image in {
            "p": reference + error,
            "r": reference,
            "ip": 0.3 * reference + error,
            "ir": 0.3 * reference,
        }.items():
            write_picture(paths[name], image)
        pairs.append({"final": Pair(paths["p"], paths["r"]), "indirect": Pair(paths["ip"], paths["ir"])})
    return pairs


def test_equal_references_and_differences_are_embedded_once(tmp_path):
    rows = rows_of_pictures(tmp_path, 3)
    keys, encoded = embed(rows, 10**7)
    assert len(encoded) == 3 + 2, "three differences, shared by both views; two references, shared by all rows"
    assert {picture.width for picture in encoded.values()} == {40}
    assert len(keys) == 6


def test_views_that_differ_otherwise_keep_their_own_difference(tmp_path):
    (row,) = rows_of_pictures(tmp_path, 1)
    write_picture(row["final"].prediction, read_picture(row["final"].reference) + 0.5)
    _, encoded = embed([row], 10**7)
    assert len(encoded) == 2 + 2


@pytest.mark.parametrize("budget", [3_000, 12_000])
def test_pictures_shrink_into_the_budget(tmp_path, budget):
    keys, encoded = embed(rows_of_pictures(tmp_path, 3), budget)
    assert sum(len(picture.data) for picture in encoded.values()) <= budget
    assert {key for pair in keys.values() for key in pair} == set(encoded)


def test_pictures_of_two_sizes_are_refused(tmp_path):
    (row,) = rows_of_pictures(tmp_path, 1)
    write_picture(row["final"].prediction, np.ones((3, 4, 3), np.float32))
    with pytest.raises(DatasetError, match="differ in size"):
        embed([row], 10**7)


def test_every_picture_the_page_names_is_in_it(page):
    parsed = Page(page)
    embedded = {a["id"].removeprefix("picture-") for tag, a in parsed.tags if tag == "script" and "data-peak" in a}
    named = {
        key
        for group in parsed.data["groups"]
        for row in group["rows"]
        for keys in row["pictures"].values()
        for key in keys
    }
    assert named == embedded


def test_measurement_points_are_shown(tmp_path, make_record):
    from PIL import Image

    Image.new("RGB", (1600, 900), "red").save(tmp_path / "points.png")
    record_files.append(tmp_path / "records.jsonl", make_record(pictures={"measurement_points": "points.png"}))
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "Measurement points on cornell" in page
    assert "data:image/png;base64," in page


def test_settings_that_share_singular_values_are_drawn_once(page):
    for group in Page(page).data["groups"]:
        assert sorted(curve["method"] for curve in group["curves"]) == ["operator-ridge", "svd-ridge"]
        assert all(curve["values"][0] == 1 for curve in group["curves"])


def test_trainings_are_drawn_from_where_they_began(tmp_path, make_record):
    curves = {"training_steps": [0, 10, 20], "training_loss": [3, 2, 1], "validation_error": [4.0, 1.0, 2.0]}
    plain, trained = make_record(), make_record("mlp-coefficients b16", curves=curves)
    record_files.append(tmp_path / "records.jsonl", plain, trained)
    (group,) = Page(write_report(tmp_path).read_text(encoding="utf-8")).data["groups"]
    (training,) = group["trainings"]
    assert training["label"] == "mlp-coefficients b16"
    assert (training["steps"], training["error"], training["best"]) == ([0, 10, 20], [1.0, 0.25, 0.5], 1)


def test_the_stability_scoreboard_is_a_section_where_the_run_has_one(tmp_path, make_record):
    record_files.append(tmp_path / "records.jsonl", make_record())
    assert 'id="stability"' not in write_report(tmp_path).read_text()
    cell = {"case": "A2", "title": "ridge of <hard> matrices", "kind": "value", "subject": "ridge", "route": "f64",
            "outcome": "failed silently", "members": 4, "headroom": 23.0, "worst": "Hilbert: error 2, bound 1"}  # fmt: skip
    board = {
        "schema": 1, "cells": [cell, {**cell, "outcome": "passed", "route": "f32"}], "mutants": [],
        "goals": [{"name": "pass rate", "value": "50 %", "goal": "100 %", "met": False, "missed": []}],
        "provenance": {"commit": "abc"},
    }  # fmt: skip
    (tmp_path / "stability.json").write_text(json.dumps(board))
    page = write_report(tmp_path).read_text()
    section = page[page.index('id="stability"') :]
    for told in ("ridge of &lt;hard&gt; matrices", "0/1", "1/1", "23", "missed", "Hilbert: error 2, bound 1"):
        assert told in section
    (tmp_path / "stability.json").write_text('{"schema": 7}')
    with pytest.raises(DatasetError, match="not a stability scoreboard"):
        write_report(tmp_path)
