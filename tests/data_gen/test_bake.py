"""The bake: determinism, resumption, atomic writes, relighting, and what it refuses."""

import errno
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import prt_bench as prt
from data_gen import bake as bake_module
from data_gen import journal
from data_gen import trace as trace_module
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.errors import DatasetError, LightError, SceneError, SpecError
from prt_bench.hemisphere import HemisphereSampler, tangent_frames

SMALL = {"scenario": "point", "lightings": 6, "texels": 24, "rays": 32, "measurements": 24, "supersampling": 2}


@pytest.fixture(scope="module")
def scene() -> prt.Scene:
    return prt.load_scene("cornell")


@pytest.fixture(scope="module")
def dataset(scene: prt.Scene, tmp_path_factory: pytest.TempPathFactory) -> prt.LightingDataset:
    return prt.bake(scene, **SMALL, ood=("directional",), out=tmp_path_factory.mktemp("data"))


def test_shapes_and_splits(dataset: prt.LightingDataset) -> None:
    receivers = len(dataset.points)
    for split, count in (("train", 6), ("test", 16), ("ood-directional", 16)):
        part = dataset.split(split)
        assert len(part) == len(part.lightings) == count
        assert part.direct.shape == part.indirect.shape == (count, receivers, 3)
        assert part.measured.shape == (count, 24, 3)
        assert np.all(part.indirect >= 0)
        assert np.all(part.direct >= 0)
    assert 0 < dataset.split("test").noise_floor < 1


def test_an_unknown_split_is_named(dataset: prt.LightingDataset) -> None:
    with pytest.raises(DatasetError, match="no split 'tset'"):
        dataset.split("tset")


@pytest.mark.parametrize("workers", [1, 2])
def test_same_seed_same_hash_for_any_number_of_workers(
    scene: prt.Scene, dataset: prt.LightingDataset, tmp_path: Path, workers: int
) -> None:
    again = prt.bake(scene, **SMALL, ood=("directional",), out=tmp_path, workers=workers)
    assert again.hash == dataset.hash
    np.testing.assert_array_equal(again.indirect, dataset.indirect)


def test_another_seed_gives_another_dataset(scene: prt.Scene, dataset: prt.LightingDataset, tmp_path: Path) -> None:
    assert prt.bake(scene, **SMALL, seed=1, out=tmp_path).hash != dataset.hash


@pytest.mark.parametrize("interrupted_after", [1, 3])
def test_an_interrupted_bake_resumes_to_the_same_bits(
    scene: prt.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interrupted_after: int
) -> None:
    monkeypatch.setattr(bake_module, "CHUNK", 100)
    monkeypatch.setattr(trace_module, "CHUNK", 100)
    whole = prt.bake(scene, **SMALL, out=tmp_path / "whole")

    add, count = journal.Journal.add, 0

    def add_then_stop(self: journal.Journal, chunk: int, **entry: object) -> None:
        nonlocal count
        add(self, chunk, **entry)
        count += 1
        if count == interrupted_after:
            raise KeyboardInterrupt

    monkeypatch.setattr(journal.Journal, "add", add_then_stop)
    with pytest.raises(KeyboardInterrupt):
        prt.bake(scene, **SMALL, out=tmp_path / "resumed")
    assert not list((tmp_path / "resumed").glob("*.zarr")) or count > len(whole.points) // 100
    again = prt.bake(scene, **SMALL, out=tmp_path / "resumed")
    assert again.hash == whole.hash
    np.testing.assert_array_equal(again.indirect, whole.indirect)
    assert not list((tmp_path / "resumed").glob("*.partial"))


def test_a_torn_journal_line_is_a_chunk_not_done(tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_text('{"chunk": 0, "digest": "a"}\n{"chunk": 1, "dig', encoding="utf-8")
    assert journal.Journal(tmp_path).done == {0: {"digest": "a"}}


def test_a_disk_without_room_is_refused_before_a_store_is_begun(
    scene: prt.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 9, 1))
    with pytest.raises(DatasetError, match="GB free, but the bake needs"):
        prt.bake(scene, **SMALL, out=tmp_path / "full")
    assert not list((tmp_path / "full").glob("*.zarr*"))


def test_a_disk_that_fills_up_is_one_sentence_and_can_be_resumed(
    scene: prt.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: journal.Journal, chunk: int, **entry: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(journal.Journal, "add", full)
        with pytest.raises(DatasetError, match="is full; free some space and run again"):
            prt.bake(scene, **SMALL, out=tmp_path)
    assert not list(tmp_path.glob("*.zarr"))
    assert prt.bake(scene, **SMALL, out=tmp_path).path


def test_relighting_gives_what_the_bake_gave(dataset: prt.LightingDataset) -> None:
    test = dataset.split("test")
    again = prt.light(dataset, test.lightings[:3]).split("test")
    np.testing.assert_array_equal(again.indirect, test.indirect[:3])
    np.testing.assert_array_equal(again.direct, test.direct[:3])
    np.testing.assert_array_equal(again.measured, test.measured[:3])


def test_a_lightmap_keeps_how_it_was_laid_out(scene: prt.Scene, dataset: prt.LightingDataset, tmp_path: Path) -> None:
    larger = {**SMALL, "texels": 96, "rays": 2}
    set_, halved = (prt.bake(scene, **larger, mips=1, texture_set=chosen, out=tmp_path) for chosen in (True, False))
    assert set_.lightmap.mips == halved.lightmap.mips == 1
    assert (set_.metadata["mips"], set_.metadata["texture_set"]) == (1, True)
    assert set_.transport.key != halved.transport.key
    assert not {"mips", "texture_set"} & set(dataset.metadata)
    with pytest.raises(SpecError, match="mips is 0, but the layout has 1"):
        prt.bake(scene, **larger, texture_set=True, layout=set_, out=tmp_path)
    posed = prt.bake(scene, **larger, mips=1, texture_set=True, layout=set_, out=tmp_path)
    assert np.array_equal(posed.lightmap.texel, set_.lightmap.texel)


def test_darkness_is_black_and_finite(dataset: prt.LightingDataset) -> None:
    dark = prt.light(dataset, [prt.Lighting(()), prt.Lighting((prt.PointLight([0, 1, 0], [0.0, 0.0, 0.0]),))])
    assert not dark.direct.any()
    assert not dark.indirect.any()
    assert dark.split("test").noise_floor == 0.0


def test_light_is_additive_through_the_whole_bake(dataset: prt.LightingDataset) -> None:
    one, other = (dataset.split("test").lightings[i].lights for i in (0, 1))
    lit = prt.light(dataset, [prt.Lighting(one), prt.Lighting(other), prt.Lighting((*one, *other))])
    np.testing.assert_allclose(lit.indirect[2], lit.indirect[0] + lit.indirect[1], rtol=1e-4, atol=1e-6)


def test_a_light_inside_a_box_is_refused(dataset: prt.LightingDataset) -> None:
    scene = dataset.scene
    box = scene.mesh.vertices[scene.mesh.faces[-6:]].reshape(-1, 3).mean(axis=0)
    with pytest.raises(LightError, match="inside"):
        prt.light(dataset, [prt.Lighting((prt.PointLight(box, [1.0, 1.0, 1.0]),))])


def test_relighting_with_nothing_is_refused(dataset: prt.LightingDataset) -> None:
    with pytest.raises(SpecError, match="no lighting"):
        prt.light(dataset, [])


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"lightings": 0}, "lightings is 0"),
        ({"rays": 3}, "rays is 3"),
        ({"tolerance": 0.0}, "tolerance is 0"),
        ({"texels": 2}, "texels is 2"),
        ({"scenario": "moonlight"}, "moonlight"),
        ({"ood": ("moonlight",)}, "moonlight"),
        ({"seed": -1}, "seed is -1"),
        ({"workers": 0}, "workers is 0"),
        ({"gather_texels": 0}, "gather_texels is 0"),
    ],
)
def test_impossible_settings_are_refused(scene: prt.Scene, tmp_path: Path, settings: dict, word: str) -> None:
    with pytest.raises(SpecError, match=word):
        prt.bake(scene, **{**SMALL, **settings}, out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_the_scene_cannot_hold_is_refused_before_any_ray(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="do not fit"):
        prt.bake(prt.load_scene("cornell"), **{**SMALL, "measurements": 10**6}, out=tmp_path)
    with pytest.raises(LightError, match="no place"):
        prt.bake(prt.load_scene("furnace"), **{**SMALL, "scenario": "directional"}, out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_another_view_of_the_scene_is_kept_and_shares_the_rays(dataset: prt.LightingDataset) -> None:
    camera = prt.Camera((0.2, 1.2, 3.5), (0.0, 1.0, 0.0), fov_y=50.0)
    out = dataset.path.parent
    turned = prt.bake(replace(dataset.scene, camera=camera), **SMALL, ood=("directional",), out=out)
    assert prt.LightingDataset.open(turned.path).scene.camera == camera
    assert prt.LightingDataset.open(dataset.path).scene.camera == dataset.scene.camera != camera
    assert turned.hash == dataset.hash
    assert len(list(out.glob("transport-*"))) == 1


def test_a_transport_that_was_taken_away_is_traced_again(scene: prt.Scene, tmp_path: Path) -> None:
    before = prt.bake(scene, **SMALL, out=tmp_path)
    (transport,) = tmp_path.glob("transport-*")
    shutil.rmtree(transport)
    assert prt.bake(scene, **SMALL, out=tmp_path).transport.key == before.transport.key


def test_out_of_scenario_splits_are_of_other_scenarios_and_named_once(
    scene: prt.Scene, dataset: prt.LightingDataset
) -> None:
    again = prt.bake(scene, **SMALL, ood=("point", "directional", "directional"), out=dataset.path.parent)
    assert again.path == dataset.path


def test_opening_what_is_not_a_dataset(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="there is no dataset"):
        prt.LightingDataset.open(tmp_path / "nowhere")
    (tmp_path / "else").mkdir()
    with pytest.raises(DatasetError, match="not a dataset"):
        prt.LightingDataset.open(tmp_path / "else")


@pytest.mark.parametrize(
    ("store", "part"),
    [("dataset", "indirect"), ("dataset", "groups"), ("dataset", "dense_points/normal"), ("transport", "receiver_hits"),
     ("transport", "scene/faces"), ("transport", "lightmap/texel")],
)  # fmt: skip
def test_a_store_that_lost_a_part_is_one_sentence(
    dataset: prt.LightingDataset, tmp_path: Path, store: str, part: str
) -> None:
    shutil.copytree(dataset.path.parent, tmp_path / "copy")
    damaged = tmp_path / "copy" / (dataset.path.name if store == "dataset" else dataset.metadata["transport"])
    shutil.rmtree(damaged / part)
    with pytest.raises(DatasetError, match=f"{damaged} has lost its {part}; delete it and bake it again"):
        prt.LightingDataset.open(tmp_path / "copy" / dataset.path.name)


def test_streamed_light_is_the_direct_light_of_further_lightings(scene: prt.Scene, tmp_path: Path) -> None:
    settings = {**SMALL, "rays": 8}
    ds, again = (prt.bake(scene, **settings, streamed=70, out=tmp_path / str(n), workers=n) for n in (1, 2))
    assert ds.hash == again.hash
    assert ds.hash != prt.bake(scene, **settings, out=tmp_path / "1").hash
    lights = sample_lightings(scene, "point", 70, [0, 2], Tracer(scene))
    known = prt.light(ds, lights[66:68])
    white = np.array([lighting.lights[0].intensity for lighting in lights[66:68]])
    scale = white.mean(axis=1) / white[:, 1]
    np.testing.assert_allclose(ds.streamed.direct[66:68], known.direct[..., 1] * scale[:, None], rtol=1e-5)
    np.testing.assert_allclose(ds.streamed.measured[66:68], known.measured[..., 1] * scale[:, None], rtol=1e-5)
    held_out, further = ({tuple(map(float, item.lights[0].position)) for item in of} for of in (ds.lightings, lights))
    assert not held_out & further


def test_directions_are_cosine_weighted_and_balanced() -> None:
    normal = np.random.default_rng(0).normal(size=(50, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sampler = HemisphereSampler.create(256, 0)
    directions = sampler.directions(7, normal)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-5)
    cosine = np.einsum("prd,pd->pr", directions, normal)
    assert cosine.min() > -1e-6
    # Under a cosine-weighted density E[cos] = 2/3 and E[cos²] = 1/2; Sobol sets come far closer than 1/√256.
    np.testing.assert_allclose(cosine.mean(axis=1), 2 / 3, atol=0.004)
    np.testing.assert_allclose((cosine**2).mean(axis=1), 1 / 2, atol=0.004)
    assert np.abs(sampler.jitter).max() <= 0.5
    # Both halves are balanced on their own, since their difference is the noise.
    np.testing.assert_allclose(cosine[:, :128].mean(axis=1), 2 / 3, atol=0.008)


def test_directions_do_not_depend_on_how_points_are_grouped() -> None:
    sampler = HemisphereSampler.create(16, 3)
    normal = np.tile([0.0, 0.0, -1.0], (10, 1))
    whole = sampler.directions(0, normal)
    np.testing.assert_array_equal(sampler.directions(4, normal[4:]), whole[4:])


def test_tangent_frames_are_rotations_everywhere() -> None:
    normal = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0, -0.8], [1e-9, 0, -1]], float)
    frames = tangent_frames(normal, np.linspace(0, 6, 5))
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-8)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-8)
