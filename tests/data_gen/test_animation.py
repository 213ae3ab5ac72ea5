"""A baked animation: points that move with the surface, lightings of its own for every keyframe, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

import prt_bench as prt
from data_gen.animation import bake_animation, keyframe_times
from data_gen.geometry import Part, is_closed
from data_gen.scenes import arm
from prt_bench.clip import Clip
from prt_bench.errors import DatasetError, SceneError, SpecError

TIMES = (0.1, 0.35, 0.8)
SMALL = {"scenario": "point", "texels": 32, "rays": 32, "measurements": 48, "supersampling": 2}


@pytest.fixture(scope="module")
def poses() -> list[prt.Scene]:
    return [prt.load_scene("arm", time) for time in TIMES]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("animation")


@pytest.fixture(scope="module")
def clip(poses: list[prt.Scene], folder: Path) -> Clip:
    return bake_animation(poses, lightings=4, out=folder, **SMALL)


def test_the_arm_bends_without_stretching_in_its_room():
    rest = arm.build()
    assert prt.load_scene("arm").hash == rest.hash
    assert arm.build(1.0).mesh.vertices == pytest.approx(rest.mesh.vertices, abs=1e-9)
    for time in np.arange(24) / 24:
        mesh = arm.build(time).mesh
        assert np.array_equal(mesh.faces, rest.mesh.faces)
        assert np.array_equal(mesh.vertices[:20], rest.mesh.vertices[:20])  # the room stands still
        figure = mesh.triangles[mesh.material == arm.ARM]
        assert is_closed(Part(figure.reshape(-1, 3), np.arange(figure[..., 0].size).reshape(-1, 3), 0))
        assert np.einsum("fd,fd->", figure[:, 0], np.cross(figure[:, 1], figure[:, 2])) > 0  # outside out
        assert np.abs(figure[..., ::2]).max() < 0.97
        assert -1e-12 <= figure[..., 1].min() <= figure[..., 1].max() < 1.9
        rings = mesh.vertices[20:-2].reshape(arm.ALONG, arm.AROUND, 3)
        centre = rings.mean(axis=1)
        assert np.linalg.norm(np.diff(centre, axis=0), axis=1).sum() == pytest.approx(arm.LENGTH, rel=3e-3)
        reach = np.linalg.norm(rings - centre[:, None], axis=2)
        assert np.allclose(reach, reach[:, :1])
    apart = [np.abs(arm.build(a).mesh.vertices - arm.build(b).mesh.vertices).max() for a, b in ((0, 0.25), (0.2, 0.6))]
    assert min(apart) > 0.5


def test_points_keep_their_place_on_the_surface(clip: Clip, poses: list[prt.Scene]):
    first = clip[0]
    for ds, scene in zip(clip, poses, strict=True):
        assert np.array_equal(ds.lightmap.texel, first.lightmap.texel)
        assert np.array_equal(ds.lightmap.corner_uv, first.lightmap.corner_uv)
        assert np.array_equal(ds.groups, first.groups)
        for points, home in (
            (ds.points, first.points),
            (ds.measurement_points, first.measurement_points),
            (ds.dense_points, first.dense_points),
            (ds.transport.samples, first.transport.samples),
        ):
            assert np.array_equal(points.face, home.face)
            assert np.array_equal(points.barycentric, home.barycentric)
            assert np.array_equal(points.albedo, home.albedo)
            corners = scene.mesh.vertices[scene.mesh.faces[home.face]]
            assert np.allclose(points.position, (home.barycentric[:, :, None] * corners).sum(axis=1), atol=1e-12)
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert np.all(np.einsum("pd,pd->p", normal, points.normal) > 0.999 * np.linalg.norm(normal, axis=1))
    on_arm = first.scene.mesh.material[first.points.face] == arm.ARM
    moved = np.linalg.norm(clip[1].points.position - first.points.position, axis=1)
    assert 0.1 < on_arm.mean() < 0.9
    assert np.all(moved[~on_arm] == 0)
    assert moved[on_arm].max() > 0.3


def test_every_keyframe_has_operator_and_lightings_of_its_own(clip: Clip):
    places = [tuple(np.asarray(light.lights[0].position)) for ds in clip for light in ds.all_lightings]
    assert len(set(places)) == len(places) == 3 * (4 + 16)
    assert not np.array_equal(clip[0].transport.receiver_hits[...], clip[1].transport.receiver_hits[...])
    assert clip.split("train").measured.shape == (12, 48, 3)
    assert clip.split("test").indirect.shape == (48, len(clip[0].points), 3)


def test_a_pose_laid_out_by_itself_is_the_plain_bake(clip: Clip, poses: list[prt.Scene], folder: Path):
    plain = prt.bake(poses[0], lightings=4, seed=7, out=folder, **SMALL)
    again = prt.bake(poses[0], lightings=4, seed=7, out=folder, layout=plain, **SMALL)
    assert again.path != plain.path
    assert again.hash == plain.hash
    assert prt.bake(poses[0], lightings=4, seed=8, out=folder, layout=plain, **SMALL).hash != plain.hash


def test_it_is_deterministic(clip: Clip, poses: list[prt.Scene], tmp_path: Path):
    again = bake_animation(poses, lightings=4, out=tmp_path, workers=1, **SMALL)
    assert [ds.hash for ds in again] == [ds.hash for ds in clip]


def test_poses_between_join_the_points_of_a_clip(clip: Clip, folder: Path):
    between = bake_animation([prt.load_scene("arm", 0.2)], lightings=1, layout=clip[0], out=folder, **SMALL)
    assert len(Clip((*clip, *between))) == 4
    assert not np.array_equal(between[0].points.position, clip[0].points.position)


def test_gather_samples_of_another_resolution_keep_their_place_too(poses: list[prt.Scene], tmp_path: Path):
    coarse = {**SMALL, "gather_texels": 24, "rays": 4}
    clip = bake_animation(poses[:2], lightings=1, out=tmp_path, **coarse)
    for part in ("face", "barycentric"):
        first, second = (getattr(ds.transport.samples, part) for ds in clip)
        assert np.array_equal(first, second)
    assert len(clip[0].transport.samples) < len(clip[0].points)


def test_keyframe_times_are_random_and_spread():
    times = keyframe_times(8, seed=3)
    assert np.array_equal(np.floor(8 * times), np.arange(8))
    assert np.array_equal(times, keyframe_times(8, seed=3))
    assert not np.array_equal(times, keyframe_times(8, seed=4))
    assert np.std(np.diff(times)) > 0.01
    with pytest.raises(SpecError, match="at least 1"):
        keyframe_times(0)


def test_what_is_refused(clip: Clip, poses: list[prt.Scene], folder: Path):
    with pytest.raises(SpecError, match="no keyframe to bake"):
        bake_animation([], **SMALL)
    with pytest.raises(SceneError, match="'cornell' is not a pose of the layout's mesh"):
        bake_animation([prt.load_scene("cornell")], lightings=1, layout=clip[0], out=folder, **SMALL)
    with pytest.raises(SpecError, match="texels is 24, but the layout has 32"):
        bake_animation(poses[1:], lightings=1, layout=clip[0], out=folder, **{**SMALL, "texels": 24})
    with pytest.raises(DatasetError, match=r"keyframe 1 .* has other points"):
        Clip((clip[0], prt.bake(poses[1], lightings=1, out=folder, **SMALL)))
    with pytest.raises(SceneError, match="'cornell' does not move"):
        prt.load_scene("cornell", 0.5)
    with pytest.raises(SceneError, match="not a built-in scene"):
        prt.load_scene("mesh.obj", 0.5)
