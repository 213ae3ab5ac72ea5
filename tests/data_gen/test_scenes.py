"""Built-in scenes: found by looking, sound as meshes, and what their descriptions promise."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.spatial import KDTree

from data_gen import assets
from data_gen.effects.subsurface import check_closed, enclosed_volume
from data_gen.fetch import MESHES
from data_gen.geometry import Part, is_closed, repair
from data_gen.scenes import (
    bunny_coarse,
    cornell,
    furnace,
    load_scene,
    plants,
    room,
    scenes,
    statue,
    summary,
    two_plates,
)
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.scene import Scene


def test_every_scene_file_is_found_by_its_name():
    folder = Path(furnace.__file__).parent
    files = {path.stem.replace("_", "-") for path in folder.glob("*.py") if path.stem != "__init__"}
    assert set(scenes()) == files >= {"cornell", "furnace", "suzanne", "two-plates"}


def scene_at_hand(name: str) -> Scene:
    """A built-in scene, or a skipped test where it needs a mesh that was not fetched."""
    mesh = name.removesuffix("-coarse")
    if mesh in MESHES and not MESHES[mesh].intact:
        pytest.skip(f"prt-bench assets {mesh} was not run")
    return load_scene(name)


@pytest.mark.parametrize("name", scenes())
def test_scene_is_sound_and_deterministic(name):
    scene = scene_at_hand(name)
    assert scene.name == name
    assert summary(name).endswith(".")
    assert repair(scene.mesh, name)[1] == ()
    assert scene.mesh.material.max() < len(scene.materials)
    assert scene.hash == load_scene(name).hash


@pytest.mark.parametrize("name", scenes())
def test_camera_sees_fronts(name):
    scene = scene_at_hand(name)
    origin = np.array(scene.camera.position)
    aims = np.array(scene.camera.target) + 0.1 * np.random.default_rng(0).normal(size=(64, 3))
    hits = Tracer(scene).intersect(np.tile(origin, (64, 1)), aims - origin)
    assert np.mean(hits.front & (hits.face >= 0)) > 0.9


def test_cornell_walls_face_inward_and_blocks_outward():
    mesh = load_scene("cornell").mesh
    centre = np.array([0.0, 1.0, 0.0])
    towards = np.einsum("fd,fd->f", mesh.normals, centre - mesh.triangles.mean(axis=1))
    assert np.all(towards[:10] > 0)
    for block in (slice(10, 22), slice(22, 34)):
        corners = mesh.triangles[block]
        middle = corners.mean(axis=(0, 1))
        assert np.all(np.einsum("fd,fd->f", mesh.normals[block], corners.mean(axis=1) - middle) > 0)
        assert corners[..., 1].min() == 0.0
    red = mesh.material == cornell.RED
    assert np.allclose(mesh.triangles[red][..., 0], -1)


def test_furnace_is_a_closed_ball_seen_from_inside():
    mesh = load_scene("furnace").mesh
    volume = np.einsum("fd,fd->f", mesh.triangles[:, 0], np.cross(mesh.triangles[:, 1], mesh.triangles[:, 2])).sum() / 6
    assert volume == pytest.approx(-4 / 3 * np.pi, rel=3e-3)
    assert np.all(np.einsum("fd,fd->f", mesh.normals, mesh.triangles.mean(axis=1)) < -0.99)
    assert furnace.indirect_irradiance(3.0) == pytest.approx(sum(3.0 * 0.5**k for k in range(1, 60)))


@pytest.mark.parametrize("point", [(0.3, 0.0, 0.2), (0.8, 0.6, 0.0), (0.01, 0.9, 0.0), (0.5, 0.0, 0.001)])
def test_view_factor_equals_its_integral(point):
    """∫ cos θ cos θ' / (π r²) over the other plate, by quadrature."""
    x, h = point[0], max(point[1:])

    def integrand(depth, across):
        return depth * h / (np.pi * ((across - x) ** 2 + depth**2 + h**2) ** 2)

    expected, _ = dblquad(integrand, 0, 1, 0, 1, epsabs=1e-9)
    assert two_plates.view_factor(np.array([point]))[0] == pytest.approx(expected, rel=1e-5)


def test_suzanne_stands_on_the_ground_in_front_of_the_wall():
    mesh = load_scene("suzanne").mesh
    figure = mesh.triangles[mesh.material == 2]
    assert len(figure) == 14_842
    assert figure[..., 1].min() == pytest.approx(0.0, abs=1e-12)
    assert np.sum(np.unique(figure.reshape(-1, 3), axis=0)[:, 1] < 2e-3) > 5  # both at chin and skull
    assert figure[..., 0].min() > mesh.triangles[mesh.material == 1][..., 0].max()


def test_the_statue_is_closed_by_domes_that_stand_out(monkeypatch):
    volume = {}
    for bulge in (-0.3, 0.0, 0.3):
        monkeypatch.setattr(statue, "_BULGE", bulge)
        scene = statue.build()
        check_closed(scene, statue.STONE)
        volume[bulge] = enclosed_volume(scene, statue.STONE)
    lower, upper = volume[0.0] - volume[-0.3], volume[0.3] - volume[0.0]
    assert lower == pytest.approx(upper, rel=0.02)
    # Two domes h cos(π s / 2) above rims of radius r enclose 2 π h r² (4 / π − 8 / π²); r is 3 to 4 cm.
    least, most = (2.0 * np.pi * 0.3 * r**3 * (4.0 / np.pi - 8.0 / np.pi**2) for r in (0.03, 0.04))
    assert least < upper < most


@pytest.mark.parametrize("name", MESHES)
def test_fetched_mesh_is_closed_and_stands_free_of_the_wall(name):
    mesh = scene_at_hand(name).mesh
    figure = mesh.triangles[mesh.material == 2]
    assert len(figure) == MESHES[name].triangles > 20_000
    assert is_closed(Part(figure.reshape(-1, 3), np.arange(figure[..., 0].size).reshape(-1, 3), 2))
    assert np.einsum("fd,fd->", figure[:, 0], np.cross(figure[:, 1], figure[:, 2])) > 0  # outside out
    assert figure[..., 1].min() == 0.0
    assert figure[..., 0].min() > mesh.triangles[mesh.material == 1][..., 0].max() + 0.1


@pytest.mark.parametrize(
    ("name", "low", "high"), [("room", 700, 24_000), ("objects", 2500, 24_000), ("plants", 5000, 21_000)]
)
def test_fine_scene_is_the_same_surface_in_smaller_triangles(name, low, high):
    coarse, fine = load_scene(name), load_scene(f"{name}-fine")
    assert len(coarse.mesh.faces) < low < 17_000 < len(fine.mesh.faces) < high
    assert (fine.camera, fine.materials) == (coarse.camera, coarse.materials)
    for index in range(len(coarse.materials)):
        areas = [scene.mesh.areas[scene.mesh.material == index].sum() for scene in (coarse, fine)]
        assert areas[0] == pytest.approx(areas[1], rel=1e-4)  # the second sides of leaves lie apart by a gap
    edges = fine.mesh.triangles - np.roll(fine.mesh.triangles, 1, axis=1)
    assert np.linalg.norm(edges, axis=2).max() < 0.071


@pytest.mark.parametrize(("name", "glossy"), [("room", {"top"}), ("objects", {"sphere", "torus", "block", "pillar"})])
def test_glossy_lobes_are_where_the_description_says(name, glossy):
    for scene in (load_scene(name), load_scene(f"{name}-fine")):
        assert {material.name for material in scene.materials if material.glossy} == glossy


def test_distant_light_reaches_the_floor_around_the_table():
    scene = load_scene("room")
    tracer = Tracer(scene)
    x, z = (values.reshape(-1) for values in np.meshgrid(*[np.linspace(-0.9, 0.9, 31)] * 2))
    floor = np.stack([x, np.full_like(x, tracer.offset), z], axis=1)
    sun = np.broadcast_to((0.6, 2.0, 1.0), floor.shape)
    dark = tracer.occluded(floor, 10.0 * sun)
    assert 0.15 < dark.mean() < 0.6
    below = (np.abs(x + 0.3 * room.TABLE_HEIGHT) < 0.4) & (np.abs(z + 0.5 * room.TABLE_HEIGHT) < 0.2)
    assert dark[below].all()


def test_leaves_and_blades_reflect_on_both_sides():
    mesh = load_scene("plants").mesh
    strips = np.isin(mesh.material, (plants.LEAF, plants.GRASS))
    assert strips.sum() == 2 * (plants.LEAVES + plants.BLADES) * 2 * (2 * plants.ALONG - 1)
    np.testing.assert_allclose(mesh.areas[strips] @ mesh.normals[strips], 0.0, atol=1e-3)  # sides in pairs
    assert mesh.triangles[strips][..., 1].min() > -1e-3  # none grows through the ground


@pytest.mark.parametrize("name", ["objects", "objects-fine"])
def test_objects_are_closed_and_stand_on_the_ground(name):
    mesh = load_scene(name).mesh
    for index in range(1, mesh.material.max() + 1):
        corners = mesh.triangles[mesh.material == index]
        assert np.einsum("fd,fd->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0  # outside out
        assert corners[..., 1].min() == pytest.approx(0.0, abs=1e-3)
        if name == "objects":
            assert is_closed(Part(np.round(corners.reshape(-1, 3), 9), np.arange(3 * len(corners)).reshape(-1, 3), 0))


def test_coarse_bunny_is_closed_and_lies_close_to_the_fine_one():
    coarse, fine = (scene_at_hand(name).mesh for name in ("bunny-coarse", "bunny"))
    figures = [mesh.triangles[mesh.material == 2] for mesh in (coarse, fine)]
    assert len(figures[0]) == 2 * (bunny_coarse.VERTICES - 2)  # Euler: closed, without handles
    assert is_closed(Part(figures[0].reshape(-1, 3), np.arange(figures[0][..., 0].size).reshape(-1, 3), 2))
    volumes = [np.einsum("fd,fd->", f[:, 0], np.cross(f[:, 1], f[:, 2])) / 6 for f in figures]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.02)
    tree = KDTree(figures[1].mean(axis=1))
    distance, nearest = tree.query(figures[0].mean(axis=1))
    assert distance.max() < 0.03
    normals = [mesh.normals[mesh.material == 2] for mesh in (coarse, fine)]
    assert np.mean(np.einsum("fd,fd->f", normals[0], normals[1][nearest]) > 0) > 0.999  # hardly a flipped face


@pytest.mark.parametrize("name", [*MESHES, "bunny-coarse"])
def test_scene_without_its_mesh_says_how_to_get_it(name, tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_BENCH_DATA", str(tmp_path))
    mesh = name.removesuffix("-coarse")
    with pytest.raises(SceneError, match=f"'prt-bench assets {mesh}' fetches it"):
        load_scene(name)


def test_vendored_files_match_their_checksums():
    folder = Path(assets.__file__).parent
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split()
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert list(assets.environment_maps()) == sorted(
        ["city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset"]
    )


@pytest.mark.parametrize(("wrong", "nearest"), [("corneli", "cornell"), ("two_plates", "two-plates")])
def test_unknown_scene_names_the_nearest(wrong, nearest):
    with pytest.raises(SceneError, match=f"did you mean '{nearest}'"):
        load_scene(wrong)
