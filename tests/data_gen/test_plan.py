"""The planner: each skip is right, and says why."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.gather import PROBES
from data_gen.tracer import Tracer
from prt_bench.lights import emitters
from prt_bench.points import SurfacePoints


def body(mesh: trimesh.Trimesh, albedo: tuple[float, float, float] = (0.5, 0.5, 0.5)) -> prt.Scene:
    made = prt.Mesh(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int))
    return prt.Scene("body", made, (prt.Material("m", albedo),), prt.Camera((0, 0, 5), (0, 0, 0)))


def faces(scene: prt.Scene) -> SurfacePoints:
    count = len(scene.mesh.faces)
    third = np.full((count, 3), 1 / 3)
    centres = scene.mesh.triangles.mean(axis=1)
    return SurfacePoints(centres, scene.mesh.normals, scene.albedo_at(np.arange(count), third), np.arange(count), third)


CONVEX = body(trimesh.creation.icosphere(subdivisions=2))
ROOM = body(trimesh.creation.icosphere(subdivisions=2).copy())
ROOM = body(trimesh.Trimesh(ROOM.mesh.vertices, ROOM.mesh.faces[:, ::-1]))
TORUS = body(trimesh.creation.torus(1.0, 0.3))


@pytest.mark.parametrize(("scene", "convex"), [(CONVEX, "outside"), (ROOM, "inside"), (TORUS, None)])
def test_convexity(scene: prt.Scene, convex: str | None) -> None:
    assert prt.plan(scene).convex == convex


@pytest.mark.parametrize(
    ("scene", "light", "skips"),
    [
        (CONVEX, prt.PointLight([0.0, 3.0, 0.0], [1.0, 1.0, 1.0]), True),
        (CONVEX, prt.DirectionalLight([0.3, -1.0, 0.0], [1.0, 1.0, 1.0]), True),
        (ROOM, prt.PointLight([0.0, 0.3, 0.2], [1.0, 1.0, 1.0]), True),
        (ROOM, prt.PointLight([0.0, 3.0, 0.0], [1.0, 1.0, 1.0]), False),
        (ROOM, prt.DirectionalLight([0.3, -1.0, 0.0], [1.0, 1.0, 1.0]), False),
        (TORUS, prt.PointLight([0.0, 3.0, 0.0], [1.0, 1.0, 1.0]), False),
    ],
)
def test_shadow_rays_are_skipped_only_where_they_change_nothing(
    scene: prt.Scene, light: prt.PointLight, skips: bool
) -> None:
    batch = emitters([prt.Lighting((light,))])
    assert prt.plan(scene).needs_shadow_rays(scene, batch) is not skips
    with_rays, without = (direct_irradiance(Tracer(scene), faces(scene), batch, rays) for rays in (True, False))
    if skips:
        np.testing.assert_array_equal(with_rays, without)
    else:
        assert not np.array_equal(with_rays, without)


def test_grey_scenes_carry_one_channel() -> None:
    assert prt.plan(CONVEX).channels == 1
    assert prt.plan(body(trimesh.creation.box(), (0.5, 0.4, 0.5))).channels == 3


def test_one_channel_changes_nothing(tmp_path: object) -> None:
    settings = {"scenario": "point", "lightings": 2, "texels": 16, "rays": 16, "measurements": 8, "supersampling": 1}
    scene = prt.load_scene("furnace")
    grey = prt.bake(scene, **settings, out=tmp_path)
    assert grey.indirect.shape[-1] == 1
    coloured = prt.light(grey, [prt.Lighting((prt.PointLight([0.1, 0.0, 0.2], [3.0, 2.0, 1.0]),))])
    white = prt.light(grey, [prt.Lighting((prt.PointLight([0.1, 0.0, 0.2], [1.0, 1.0, 1.0]),))])
    np.testing.assert_allclose(coloured.indirect, white.indirect * np.array([3.0, 2.0, 1.0]), rtol=1e-5)


@pytest.mark.parametrize("albedo", [0.0, 0.2, 0.9])
def test_bounces_follow_the_tail_bound(albedo: float) -> None:
    plan = prt.plan(body(trimesh.creation.torus(1.0, 0.3), (albedo,) * 3), tolerance=1e-3)
    assert albedo**plan.bounces / (1 - albedo) <= 1e-3 or albedo == 0


def test_table_says_what_and_why() -> None:
    table = prt.plan(prt.load_scene("cornell")).table()
    for word in ("bounces", "channels", "shadow rays", "gather rays", "MB on disk", "albedo differs"):
        assert word in table


def test_prediction_scales_with_the_work() -> None:
    scene = prt.load_scene("cornell")
    small, large = (prt.plan(scene, rays=rays).cost for rays in (64, 256))
    probes = PROBES * round(0.75 * 128**2)  # of what is buried, whatever the rays
    assert large.gather_rays - probes == 4 * (small.gather_rays - probes)
    assert replace(large, seconds=0.0) != replace(small, seconds=0.0)
