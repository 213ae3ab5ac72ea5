"""Simulating in full what nothing calls for changes nothing but cost."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.decisions import FORCIBLE, forced
from data_gen.trace import transport_key
from prt_bench.errors import RuntimeUnavailable, SpecError
from prt_bench.methods.operator import importance
from prt_bench.runtime.runtime import Runtime

SMALL: dict[str, Any] = {
    "scenario": "point", "lightings": 3, "texels": 24, "rays": 16, "measurements": 8, "supersampling": 1,
}  # fmt: skip


def rows(plan: Any) -> dict[str, tuple[str, str]]:
    return {row["what"]: (row["decision"], row["why"]) for row in plan.to_json()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("forced")


@pytest.mark.parametrize("name", ["cornell", "furnace"])
def test_an_effect_that_nothing_calls_for_changes_nothing(name: str, folder: Path) -> None:
    scene = prt.load_scene(name)
    without, with_it = (prt.bake(scene, **SMALL, force=force, out=folder) for force in ((), ("subsurface",)))
    assert without.transport.walks is None
    walks = with_it.transport.walks
    assert walks is not None
    assert len(walks.samples.rows) == 0
    assert with_it.metadata["effects"] == ["subsurface"]
    assert with_it.hash == without.hash
    for array in ("direct", "indirect", "measured", "noise", "shown_direct"):
        np.testing.assert_array_equal(getattr(with_it, array), getattr(without, array))


def test_what_goes_through_the_operator_does_not_notice(folder: Path) -> None:
    scene = prt.load_scene("cornell")
    without, with_it = (prt.bake(scene, **SMALL, force=force, out=folder) for force in ((), ("subsurface",)))
    u = jnp.asarray(np.random.default_rng(0).normal(size=(len(without.points), 2)))
    found = [importance(ds.transport, jnp.asarray(ds.transport.samples.albedo), u) for ds in (without, with_it)]
    np.testing.assert_allclose(*found, rtol=1e-12, atol=1e-12)
    one, other = (prt.method("sh-texture", order=2).fit(ds.split("train")) for ds in (without, with_it))
    test = without.split("test")
    np.testing.assert_allclose(one.predict(test), other.predict(test), rtol=1e-5, atol=1e-6)


def test_frames_are_the_same(folder: Path) -> None:
    scene = prt.load_scene("cornell")
    frames = []
    for force in ((), ("subsurface",)):
        ds = prt.bake(scene, **SMALL, force=force, out=folder)
        try:
            runtime = Runtime(ds, (64, 48), 256)
        except RuntimeUnavailable as error:
            pytest.skip(str(error))
        assert runtime.mesh.translucent == bool(force)
        test = ds.split("test")
        frames.append(runtime.frame(test.lightings[0], runtime.lightmap(test.indirect[0]), True))
    assert frames[0].max() > 0
    np.testing.assert_array_equal(*frames)


def test_forced_channels_and_shadow_rays_are_simulated_on_the_same_rays(folder: Path) -> None:
    scene = prt.load_scene("furnace")
    planned = prt.bake(scene, **SMALL, out=folder)
    full = prt.bake(scene, **SMALL, force=("shadow rays", "channels"), out=folder)
    assert (planned.indirect.shape[2], full.indirect.shape[2]) == (1, 3)
    assert full.transport.key == planned.transport.key
    assert full.metadata["actual"]["traced_before"]
    assert full.metadata["actual"]["shadow_rays"] > planned.metadata["actual"]["shadow_rays"] == 0
    np.testing.assert_array_equal(full.indirect, np.repeat(planned.indirect, 3, axis=2))
    np.testing.assert_array_equal(full.direct, np.repeat(planned.direct, 3, axis=2))
    again = prt.light(full, full.split("test").lightings[:2])
    assert again.indirect.shape[2] == 3
    np.testing.assert_array_equal(again.indirect, full.split("test").indirect[:2])


def test_forced_bounces_are_more_and_hold_less_back(folder: Path) -> None:
    scene = prt.load_scene("cornell")
    planned, full = (prt.bake(scene, **SMALL, force=force, out=folder) for force in ((), ("bounces",)))
    assert full.transport.bounces > planned.transport.bounces
    assert full.transport.key != planned.transport.key
    apart = np.abs(full.indirect - planned.indirect).max(axis=(1, 2))
    assert np.all(apart > 0)
    assert np.all(apart <= planned.metadata["tolerance"] * full.direct.max(axis=(1, 2)))


def test_forced_receivers_are_those_of_a_bake_without_nodes(folder: Path) -> None:
    """The same rays; and what nodes had saved of them missed no more than it was allowed."""
    scene = prt.load_scene("cornell")
    settings = {**SMALL, "texels": 40, "gather_texels": 24}
    nodes = {"node_rays": 64, "node_tolerance": 0.2}
    between = prt.bake(scene, **settings, **nodes, out=folder)
    assert between.transport.nodes is not None
    sides = {"texels": 40, "gather_texels": 24, "rays": settings["rays"]}
    plain, full = prt.plan(scene, **sides), prt.plan(scene, **sides, **nodes, force=("receivers",))
    assert transport_key(scene, full, 0) == transport_key(scene, plain, 0) != between.transport.key
    assert rows(full)["receivers"] == ("all traced", "forced: 64 rays at nodes were asked for")
    (found,) = (skip for skip in prt.skips(between, 2, timed=False) if skip.name == "receivers")
    assert (found.planned, found.full) == ("64 rays at nodes", f"{settings['rays']} rays at all")
    assert 0 <= found.error <= found.tolerance == 0.2
    assert found.rays == len(between.points) * settings["rays"] - between.transport.receiver_hits.size


def test_the_plan_says_what_was_forced() -> None:
    plan = rows(prt.plan(prt.load_scene("furnace"), texels=320, force=("all",)))
    assert plan["channels"] == ("3", "forced: every albedo is grey")
    assert plan["shadow rays"][0] == "yes"
    assert plan["gather samples"] == ("320² texels", "forced: the receivers themselves")
    assert plan["bounces"][1].startswith("forced")
    assert plan["subsurface"][0] == "walks from 0 points"
    calls_for_all = rows(prt.plan(prt.load_scene("candle"), force=("all",)))
    assert not [
        row for what, row in calls_for_all.items() if "forced" in row[1] and what not in ("bounces", "gather samples")
    ]


def test_what_is_not_forced_keeps_its_names(folder: Path) -> None:
    scene = prt.load_scene("cornell")
    plain, none = (prt.plan(scene, texels=24, rays=32, **more) for more in ({}, {"force": (), "noise": 0.5}))
    assert transport_key(scene, plain, 0) == transport_key(scene, none, 0)
    keys = {transport_key(scene, prt.plan(scene, texels=24, rays=32, force=(name,)), 0) for name in FORCIBLE}
    assert len(keys) == 3  # as it was, with walks, with all bounces: the rest needs no other rays
    assert prt.bake(scene, **SMALL, out=folder).path == prt.bake(scene, **SMALL, noise=0.5, out=folder).path


def test_names_are_known_once_and_in_order() -> None:
    assert forced(("bounces", "channels", "bounces")) == ("channels", "bounces")
    assert forced(("all",)) == FORCIBLE
    with pytest.raises(SpecError, match="'hare' cannot be forced; valid are subsurface"):
        forced(("hare",))
