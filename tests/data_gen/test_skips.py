"""What the planner leaves out changes the light by less than it says, on every built-in scene; and errors would be seen."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import zarr

import prt_bench as prt
from data_gen.decisions import FORCIBLE
from data_gen.fetch import MESHES
from data_gen.pilot import relative_bias
from data_gen.skips import skips
from data_gen.strands import with_strands, without_strands
from prt_bench.errors import SpecError
from prt_bench.scene import Scene
from prt_bench.store import data_folder
from prt_bench.strands import Strands

TINY: dict[str, Any] = {
    "scenario": "point",
    "lightings": 1,
    "texels": 32,
    "rays": 32,
    "measurements": 8,
    "supersampling": 1,
}
MANY_CHARTS = (
    "apartment",
    "bunny",
    "elephant",
    "plants",
    "plants-fine",
    "room",
    "room-fine",
)  # they do not fit 32² texels
ARRAYS = {"measured", "direct", "indirect", "indirect_half", "noise", "groups", "measurement_points", "dense_points"}


def tiny(name: str, folder: Path, **settings: Any) -> prt.LightingDataset:
    """A small bake of a built-in scene, or a skipped test where its mesh or charts are not at hand."""
    mesh = name.removesuffix("-coarse")
    if mesh in MESHES and not MESHES[mesh].intact:
        pytest.skip(f"prt-bench assets {mesh} was not run")
    charts = list(data_folder().glob(f"charts-{name}-*.npz"))
    if name in MESHES and not charts:
        pytest.skip(f"{name} was not baked before, and cutting it into charts takes a minute")
    for file in charts:
        shutil.copy(file, folder)
    scene = thinned(prt.load_scene(name))
    side = 64 if name in MANY_CHARTS or scene.strands is not None else TINY["texels"]
    return prt.bake(scene, **{**TINY, "texels": side, **settings}, out=folder)


def thinned(scene: Scene) -> Scene:
    """The scene with a hundred of its strands of hair, ten times as thick; itself where it has none."""
    hair = scene.strands
    if hair is None:
        return scene
    kept = np.linspace(0, len(hair) - 1, 100).astype(int)
    nodes = [hair.nodes[hair.starts[i] : hair.starts[i + 1]] for i in kept]
    starts = np.cumsum([0] + [len(each) for each in nodes])
    fewer = Strands(np.concatenate(nodes), starts, 10.0 * hair.radius[kept], hair.material[kept])
    return with_strands(without_strands(scene), fewer)


@pytest.mark.parametrize("name", prt.scenes())
def test_every_skip_is_within_its_tolerance(name: str, tmp_path: Path) -> None:
    ds = tiny(name, tmp_path)
    found = {skip.name: skip for skip in skips(ds, 2, timed=False)}
    assert found
    for skip in found.values():
        assert skip.error <= skip.tolerance, skip
    assert ("channels" in found) == ds.scene.achromatic
    assert ("subsurface" in found) == (not ds.scene.translucent)
    for exact in ("subsurface", "channels", "shadow rays"):
        assert exact not in found or found[exact].error == 0
    group = zarr.open_group(ds.path, mode="r")
    assert set(group) == ARRAYS
    assert ("walks" in zarr.open_group(tmp_path / ds.metadata["transport"], mode="r")) == ds.scene.translucent


@pytest.fixture(scope="module")
def cornell(tmp_path_factory: pytest.TempPathFactory) -> prt.LightingDataset:
    return tiny("cornell", tmp_path_factory.mktemp("cornell"))


def test_bounces_too_few_are_seen(cornell: prt.LightingDataset) -> None:
    short = replace(cornell, transport=replace(cornell.transport, bounces=4))
    (bounces,) = (skip for skip in skips(short, 2, timed=False) if skip.name == "bounces")
    assert bounces.error > bounces.tolerance


def test_shadow_rays_that_matter_are_seen(cornell: prt.LightingDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    from data_gen import plan as planner

    monkeypatch.setattr(planner, "_convexity", lambda _: "outside")
    (shadows,) = (skip for skip in skips(cornell, 2, timed=False) if skip.name == "shadow rays")
    assert shadows.error > 0.01
    assert shadows.rays > 0


def test_gather_samples_too_coarse_are_seen_and_fine_ones_pass(tmp_path: Path) -> None:
    settings = {"texels": 96, "rays": 64, "gather_tolerance": 0.08, "out": tmp_path}
    chosen, coarse = (
        prt.bake(prt.load_scene("cornell"), **{**TINY, **settings}, gather_texels=side) for side in ("auto", 24)
    )
    assert chosen.metadata["gather_texels"] == 32
    assert "light bounced once is off by" in str(chosen.metadata["plan"])
    for ds, held in ((chosen, True), (coarse, False)):
        (samples,) = (skip for skip in skips(ds, 8, timed=False) if skip.name == "gather samples")
        assert (samples.error <= samples.tolerance) == held, samples
        assert samples.planned == f"{ds.metadata['gather_texels']}² texels"


def test_a_lone_convex_body_is_not_shadowed_and_seen_by_nothing(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = prt.Mesh(ball.vertices, ball.faces, np.zeros(len(ball.faces), int))
    scene = prt.Scene("ball", mesh, (prt.Material("m", (0.5, 0.5, 0.5)),), prt.Camera((0, 0, 5), (0, 0, 0)))
    ds = prt.bake(scene, **TINY, out=tmp_path)
    found = {skip.name: skip for skip in skips(ds, 2)}
    assert set(found) == {"subsurface", "channels", "shadow rays"}  # nothing bounces, so no bounce was left out
    assert all(skip.error == 0 for skip in found.values())
    assert found["shadow rays"].rays > 0
    assert found["channels"].bytes == 2 * sum(ds.arrays[name].nbytes for name in ARRAYS & set(ds.arrays) - {"noise"})


def test_what_is_forced_is_not_left_out(tmp_path: Path) -> None:
    ds = tiny("furnace", tmp_path, force=("all",))
    assert skips(ds, 1, timed=False) == []
    assert ds.metadata["force"] == list(FORCIBLE)


def test_without_lightings_there_is_nothing_to_measure_on(cornell: prt.LightingDataset) -> None:
    with pytest.raises(SpecError, match="on 0 lightings"):
        skips(cornell, 0)


def test_bias_is_what_is_left_of_a_difference_less_its_noise() -> None:
    random = np.random.default_rng(0)
    whole = np.full((4, 20_000, 1), 2.0)
    first, second = (0.06 + random.normal(0, 0.2, whole.shape) for _ in range(2))
    assert relative_bias(first, second, whole) == pytest.approx(0.03, rel=0.1)
    assert relative_bias(first - 0.06, second - 0.06, whole) < 0.008
