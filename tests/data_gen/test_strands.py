"""Strands: their tubes, their texels, how they grow, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
import zarr

import prt_bench as prt
from data_gen.strand_atlas import points_with_strands, unwrap_with_strands
from data_gen.strands import Growth, grow, strands_of, with_strands, without_strands
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError, SpecError
from prt_bench.hair import Hair
from prt_bench.scene import Glossy, Material
from prt_bench.store import read_scene, write_scene
from prt_bench.strands import TEXELS, Strands
from tests.data_gen.tuft import FIBRES, GROUND, tuft


def bent(count: int = 20) -> Strands:
    rng = np.random.default_rng(4)
    steps = np.array([0.0, 1.0, 0.0]) + 0.2 * rng.normal(size=(count, 5, 3))
    nodes = np.cumsum(steps, axis=1).reshape(-1, 3)
    return Strands(nodes, 5 * np.arange(count + 1), np.full(count, 0.02), np.zeros(count, int))


def test_tubes_face_outward_and_are_as_wide_as_their_fibres() -> None:
    strands = bent()
    corners = strands.vertices[strands.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - strands.nodes[strands.corners[0]].mean(axis=1)
    assert np.all(np.einsum("fd,fd->f", normal, away) > 0)
    assert len(strands.faces) == 20 * (3 * 6 + 3)
    # Half of a tube's faces show: seen across from all sides, a straight prism is 2 r wide on average.
    straight = Strands(
        np.array([(0, 0, 0), (0, 5, 0), (0, 5.001, 0.0)], float), np.array([0, 3]), np.array([0.1]), np.zeros(1, int)
    )
    triangles = straight.vertices[straight.faces]
    areas = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    angle = 2.0 * np.pi * np.arange(360) / 360
    views = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    width = np.maximum(areas[:6] @ views.T, 0.0).sum(axis=0) / 5.0
    assert width.mean() == pytest.approx(0.2, rel=1e-3)
    assert width.min() > 0.9 * 0.2


def test_places_along_strands() -> None:
    strands = bent()
    every, at = np.repeat(np.arange(20), 3), np.tile([0.0, 0.37, 1.0], 20)
    position, segment = strands.at(every, at)
    np.testing.assert_allclose(position[::3], strands.nodes[strands.starts[:-1]], atol=1e-12)
    np.testing.assert_allclose(position[2::3], strands.nodes[strands.starts[1:] - 1], atol=1e-12)
    assert np.all(strands.owner[strands.first[segment]] == every)
    walked = [np.interp(0.37, strands.along[5 * i : 5 * i + 5], strands.nodes[5 * i : 5 * i + 5, 1]) for i in range(20)]
    np.testing.assert_allclose(position[1::3, 1], walked, rtol=1e-12)


def test_ten_texels_a_strand_in_rows() -> None:
    scene = tuft(Hair(), 57, ground=True)
    lightmap = unwrap_with_strands(scene, 64)
    points = points_with_strands(scene, lightmap)
    assert points.clearance is not None
    fibre = points.clearance > 0
    assert fibre.sum() == 57 * TEXELS
    assert len(points) == len(lightmap.texel)
    assert len(np.unique(lightmap.texel)) == len(lightmap.texel)
    row, column = np.divmod(lightmap.texel[fibre].reshape(57, TEXELS), 64)
    assert np.all(row == row[:, :1])
    assert np.all(np.diff(column, axis=1) == 1)
    assert len(np.unique(row)) == 10  # six strands a row
    # Corner coordinates stay at the centres of the strand's own row, and what lies between within its texels.
    owner = np.repeat(np.arange(57), 15)
    uv = lightmap.corner_uv[scene.surfaces :] * 64
    np.testing.assert_allclose(uv[..., 1] - row[owner, :1], 0.5)
    assert np.all((uv[..., 0] >= column[owner, :1] + 0.5 - 1e-9) & (uv[..., 0] <= column[owner, -1:] + 0.5 + 1e-9))
    position = points.position[fibre].reshape(57, TEXELS, 3)
    assert scene.strands is not None
    assert np.all(np.linalg.norm(position[:, 0] - scene.strands.nodes[::4], axis=1) < 0.03)
    assert np.linalg.norm(points.normal, axis=1) == pytest.approx(1.0)
    with pytest.raises(SceneError, match="ask for 42 or more"):
        unwrap_with_strands(scene, 24)
    with pytest.raises(SpecError, match="cannot be halved"):
        unwrap_with_strands(scene, 64, mips=1)


def test_growth_is_seeded_and_stays_on_its_surface() -> None:
    scene = without_strands(tuft(Hair(), 1, ground=True))
    growth = Growth(0.2, 0.002, segments=3)
    first, again, other = (grow(scene, GROUND, FIBRES, 50, growth, seed) for seed in (1, 1, 2))
    assert first.hash == again.hash != other.hash
    assert first.strands is not None
    roots = first.strands.nodes[::4]
    np.testing.assert_allclose(roots[:, 1], -0.9)
    assert np.all(first.strands.nodes[1::4, 1] > -0.9)
    assert without_strands(first).hash == scene.hash
    more = with_strands(first, first.strands)
    assert more.strands is not None
    assert len(more.strands) == 100
    assert more.surfaces == 2
    hits = Tracer(first).intersect(np.array([[0.0, 2.0, 0.0]]), np.array([[0.0, -1.0, 0.0]]))
    assert hits.face[0] >= 0


def test_strands_without_length_are_left_out_and_named() -> None:
    line = np.array([(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 2.0, 0.0)])
    strands, notes = strands_of([line, np.zeros((3, 3)), line[:1]], 0.01, 0)
    assert len(strands) == 1
    assert len(strands.nodes) == 3
    assert notes == ("dropped 2 strands without length of 3",)
    with pytest.raises(SceneError, match="there are no strands"):
        strands_of([np.zeros((2, 3))], 0.01, 0)


def test_what_no_hair_can_be_is_refused() -> None:
    nodes, ends = np.array([(0.0, 0.0, 0.0), (0.0, 1.0, 0.0)]), np.array([0, 2])
    one, zero = np.ones(1), np.zeros(1, int)
    for broken, message in (
        ((nodes * 0, ends, one, zero), "two nodes in one place"),
        ((nodes * np.nan, ends, one, zero), "not finite"),
        ((nodes, ends, 0 * one, zero), "radius above zero"),
        ((nodes, np.array([0, 1, 2]), np.ones(2), np.zeros(2, int)), "at least two nodes"),
    ):
        with pytest.raises(SceneError, match=message):
            Strands(*broken)
    scene = tuft(Hair(), 1, ground=True)
    with pytest.raises(SceneError, match="material 0, which is not hair"):
        with_strands(scene, Strands(nodes, ends, one, zero))
    with pytest.raises(SceneError, match="no faces of material 1"):
        grow(scene, FIBRES, FIBRES, 5, Growth(0.1, 0.001))
    with pytest.raises(SceneError, match="0 strands"):
        grow(scene, GROUND, FIBRES, 0, Growth(0.1, 0.001))
    with pytest.raises(SceneError, match="length -1"):
        Growth(-1.0, 0.001)
    with pytest.raises(SceneError, match="is hair, which has neither"):
        Material("hair", hair=Hair(), glossy=Glossy())


def test_a_scene_survives_the_store(tmp_path: Path) -> None:
    scene = tuft(Hair((0.1, 0.2, 0.3), ior=1.4), 7, ground=True)
    group = zarr.open_group(tmp_path / "scene.zarr", mode="a")
    write_scene(group, scene)
    again = read_scene(group)
    assert again.hash == scene.hash
    assert again.materials[FIBRES].hair == scene.materials[FIBRES].hair
    assert again.strands is not None
    assert again.surfaces == 2
    assert scene.hash != tuft(Hair((0.1, 0.2, 0.3), ior=1.5), 7, ground=True).hash


def test_the_standard_scenes_have_as_many_strands_as_they_say() -> None:
    from data_gen.scenes import hairball

    scene = prt.load_scene("hair")
    assert scene.strands is not None
    assert len(scene.strands) == 10_000
    assert scene.strands.nodes[:, 1].min() > 0.0
    few = hairball.build(300)
    assert few.strands is not None
    assert len(few.strands) == 300


def test_a_scene_file_grows_hair(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1, radius=0.2).export(tmp_path / "ball.ply")
    name = prt.load_scene(tmp_path / "ball.ply").materials[0].name
    head = f'mesh = "ball.ply"\nscale = 1.0\n[hair.fur]\non = "{name}"\n'
    body = "strands = 40\nlength = 0.1\nradius = 0.001\n"
    (tmp_path / "a.toml").write_text(head + body + "colour = [0.5, 0.3, 0.2]\nior = 1.4\nsegments = 2\nseed = 3\n")
    scene = prt.load_scene(tmp_path / "a.toml")
    assert scene.strands is not None
    assert len(scene.strands) == 40
    assert len(scene.strands.nodes) == 120
    fibres = scene.materials[-1].hair
    assert fibres is not None
    assert fibres.ior == 1.4
    for rest, message in (
        (body, "needs either a colour or an absorption"),
        ("strands = 40\ncolour = [0.5, 0.3, 0.2]\n", "needs on, strands, length and radius"),
        (body + "colour = [0.5, 0.3, 0.0]\n", "above 0 and up to 1"),
        (body + "colour = [0.5, 0.3, 0.2]\nlenght = 1.0\n", "did you mean 'hair.fur.length'"),
        (body + "colour = [0.5, 0.3, 0.2]\nseed = 0.5\n", "must be a whole number"),
        (body.replace("40", "0") + "colour = [0.5, 0.3, 0.2]\n", "0 strands"),
    ):
        (tmp_path / "b.toml").write_text(head + rest)
        with pytest.raises(SceneError, match=message):
            prt.load_scene(tmp_path / "b.toml")
