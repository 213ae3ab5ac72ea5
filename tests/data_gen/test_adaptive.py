"""Rays per point chosen for a noise, and predicted cost beside actual."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import prt_bench as prt
from data_gen import bake as bake_module
from data_gen import journal
from data_gen import trace as trace_module
from data_gen.cost import comparison
from data_gen.pilot import LEAST_RAYS, MOST_RAYS, Pilot
from data_gen.plan import with_more_rays
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.errors import SpecError

SMALL: dict[str, Any] = {
    "scenario": "point", "lightings": 3, "texels": 24, "measurements": 8, "supersampling": 1, "rays": "auto", "noise": 0.15,
}  # fmt: skip


@pytest.fixture(scope="module")
def scene() -> prt.Scene:
    return prt.load_scene("cornell")


@pytest.fixture(scope="module")
def dataset(scene: prt.Scene, tmp_path_factory: pytest.TempPathFactory) -> prt.LightingDataset:
    return prt.bake(scene, **SMALL, out=tmp_path_factory.mktemp("auto"))


def test_the_noise_that_was_asked_for_is_reached_and_not_by_far(dataset: prt.LightingDataset) -> None:
    assert dataset.split("test").noise_floor <= 0.15
    assert LEAST_RAYS < dataset.metadata["rays"] <= 128
    fewer = prt.bake(
        dataset.scene, **{**SMALL, "rays": dataset.metadata["rays"] // 2}, out=dataset.path and dataset.path.parent
    )
    assert fewer.split("test").noise_floor > 0.15
    (row,) = (row for row in dataset.metadata["plan"] if row["what"] == "rays per point")
    assert row["decision"] == str(dataset.metadata["rays"])
    assert "asked for 15.0%" in row["why"]


def test_chosen_rays_are_the_rays_of_that_number(dataset: prt.LightingDataset, tmp_path: Path) -> None:
    """Same transport, same bits; only the dataset remembers what was asked for."""
    told = prt.bake(dataset.scene, **{**SMALL, "rays": dataset.metadata["rays"]}, out=tmp_path, workers=1)
    assert told.transport.key == dataset.transport.key
    assert told.hash == dataset.hash
    assert told.metadata["actual"].keys() == dataset.metadata["actual"].keys()
    assert dataset.metadata["noise"] == 0.15
    assert "noise" not in told.metadata


@pytest.mark.parametrize("name", ["cornell", "candle"])
def test_the_pilot_foretells_the_noise_of_the_bake(name: str, tmp_path: Path) -> None:
    scene = prt.load_scene(name)
    ds = prt.bake(scene, **{**SMALL, "texels": 32, "rays": 64}, out=tmp_path)
    settings = prt.plan(scene, texels=32, rays=64)
    tracer = Tracer(scene)
    pilot = Pilot(scene, settings, sample_lightings(scene, "point", 16, [0, 1], tracer), 0, tmp_path, tracer)
    assert pilot.noise(64) == pytest.approx(ds.split("test").noise_floor, rel=0.15)


def test_a_bake_that_is_noisier_than_its_pilot_goes_on(
    scene: prt.Scene, dataset: prt.LightingDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = dataset.metadata["rays"] // 4
    monkeypatch.setattr(Pilot, "rays", lambda self, noise: (few, [(few, noise)]))
    again = prt.bake(scene, **SMALL, out=tmp_path)
    assert again.hash == dataset.hash
    assert again.metadata["rays"] == dataset.metadata["rays"]
    assert f"{2 * few} left" in str(again.metadata["plan"])


def test_an_interrupted_bake_resumes_to_the_same_bits(
    scene: prt.Scene, dataset: prt.LightingDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bake_module, "CHUNK", 100)
    monkeypatch.setattr(trace_module, "CHUNK", 100)
    add = journal.Journal.add

    def add_then_stop(self: journal.Journal, chunk: int, **entry: object) -> None:
        add(self, chunk, **entry)
        if chunk == 1:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(journal.Journal, "add", add_then_stop)
        with pytest.raises(KeyboardInterrupt):
            prt.bake(scene, **SMALL, out=tmp_path)
    again = prt.bake(scene, **SMALL, out=tmp_path)
    np.testing.assert_array_equal(again.indirect, dataset.indirect)
    assert again.metadata["actual"]["resumed"]
    assert not dataset.metadata["actual"]["resumed"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rays": "many"}, "rays is 'many', but must be a number or 'auto'"),
        ({"texels": "auto"}, "texels is 'auto', but must be a number"),
        ({"noise": 0.0}, "noise is 0.0, but it must lie between 0 and 1"),
        ({"gather_tolerance": 1.5}, "gather_tolerance is 1.5"),
        ({"gather_texels": 16, "node_rays": 64}, "receivers have the rays of node_rays"),
        ({"noise": 1e-6}, f"noise is 1e-06, but {MOST_RAYS // 64} rays per point leave"),
    ],
)
def test_what_cannot_be_chosen_is_refused(
    scene: prt.Scene, tmp_path: Path, settings: dict, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("data_gen.pilot.MOST_RAYS", MOST_RAYS // 64)
    with pytest.raises(SpecError, match=message):
        prt.bake(scene, **{**SMALL, **settings}, out=tmp_path)
    assert not list(tmp_path.glob("*.zarr*"))


def test_rays_do_not_double_for_ever(scene: prt.Scene) -> None:
    settings = replace(prt.plan(scene), noise=0.01, rays=MOST_RAYS)
    with pytest.raises(SpecError, match=f"{MOST_RAYS} rays per point leave 0.02 in 'cornell'; allow more noise"):
        with_more_rays(settings, scene, 0.02)


def test_actual_cost_is_what_was_cast_and_stored(scene: prt.Scene, tmp_path: Path) -> None:
    ds = prt.bake(scene, **{**SMALL, "rays": 64}, out=tmp_path)
    actual, predicted = ds.metadata["actual"], ds.metadata["predicted"]
    hits = ds.transport.receiver_hits.shape
    table, probes = hits[0] * hits[1], 16 * hits[0]
    assert actual["gather_rays"] == table + probes
    assert 0 < actual["shadow_rays"] <= predicted["shadow_rays"]
    stored = sum(
        file.stat().st_size
        for path in (ds.path, tmp_path / ds.metadata["transport"])
        for file in path.rglob("*")
        if file.is_file()
    )
    assert actual["disk_bytes"] == pytest.approx(stored, rel=0.1)
    assert actual["seconds"] == pytest.approx(ds.metadata["seconds"]["trace"] + ds.metadata["seconds"]["light"])
    relit = prt.bake(scene, **{**SMALL, "rays": 64, "lightings": 4}, out=tmp_path)
    assert relit.metadata["actual"]["traced_before"]
    assert relit.metadata["actual"]["gather_rays"] == 0
    text = comparison(relit.metadata["predicted"], relit.metadata["actual"])
    assert "the rays of the scene had been traced before" in text
    assert [line.split("  ")[0].strip() for line in text.splitlines()[1:6]] == [
        name.replace("_", " ") for name in predicted
    ]
