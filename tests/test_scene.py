"""Materials beyond diffuse: what a glossy lobe and a normal image may be, where they are looked up, hashed and kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zarr

from data_gen.geometry import assemble, quad
from data_gen.scenes import load_scene
from prt_bench.errors import SceneError
from prt_bench.scene import Camera, Glossy, Material, Mesh, Scene
from prt_bench.store import read_scene, write_scene

RNG = np.random.default_rng(3)
ROUGHNESS = RNG.uniform(0.1, 1.0, (4, 6))
NORMALS = np.concatenate([RNG.uniform(-0.5, 0.5, (4, 6, 2)), np.ones((4, 6, 1))], axis=2)
FLAT = np.tile([0.0, 0.0, 2.0], (3, 3, 1))
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def scene_of(*materials: Material, uv: np.ndarray | None = None) -> Scene:
    """A unit square facing +z per material, one above the other; by default u is x and v is y."""
    mesh = assemble([quad([(x, y, index) for x, y, _ in SQUARE], index) for index in range(len(materials))])
    uv = mesh.triangles[..., :2].copy() if uv is None else uv
    return Scene("squares", replace(mesh, uv=uv), materials, Camera((0, 0, 3), (0, 0, 0)))


def some_points(scene: Scene, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    return RNG.integers(0, len(scene.mesh.faces), count), RNG.dirichlet([1.0, 1.0, 1.0], count)


def test_a_lobe_is_found_where_its_material_is():
    scene = scene_of(Material("dull"), Material("shiny", glossy=Glossy((0.1, 0.2, 0.3), 40.0)))
    assert scene.glossy
    assert not scene_of(Material()).glossy
    face, barycentric = some_points(scene)
    specular, exponent = scene.glossy_at(face, barycentric)
    shiny = scene.mesh.material[face] == 1
    assert np.all(specular[shiny] == (0.1, 0.2, 0.3))
    assert np.all(exponent[shiny] == 40.0)
    assert not specular[~shiny].any()
    assert not exponent[~shiny].any()


def test_roughness_is_looked_up_as_albedo_is():
    image = np.repeat(ROUGHNESS[..., None], 3, axis=2)
    scene = scene_of(Material("m", (0.7, 0.7, 0.7), image, glossy=Glossy(roughness_image=ROUGHNESS)))
    face, barycentric = some_points(scene)
    roughness = scene.albedo_at(face, barycentric)[:, 0] / 0.7
    np.testing.assert_allclose(scene.glossy_at(face, barycentric)[1], 2.0 / roughness**2 - 2.0, rtol=1e-9)
    assert scene_of(Material(glossy=Glossy(roughness_image=np.ones((2, 2))))).glossy_at(face, barycentric)[1].max() == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Glossy((0.2, 0.2, 1.2)), "three numbers from 0 to 1"),
        (lambda: Glossy(exponent=-1.0), "from 0 to 1e"),
        (lambda: Glossy(exponent=float("inf")), "perfect mirror"),
        (lambda: Glossy(exponent=float("nan")), "from 0 to 1e"),
        (lambda: Glossy(roughness_image=np.zeros((2, 2))), r"roughness image .* from 0\.0014 to 1"),
        (lambda: Material("gilt", (0.5, 0.5, 0.9), glossy=Glossy()), "'gilt' reflects more than arrives"),
        (lambda: Material("bump", normal_image=np.zeros((2, 2, 3))), "'bump' must hold vectors .* 2c − 1"),
        (lambda: Material("bump", normal_image=np.ones((2, 2))), "'bump' must hold vectors"),
    ],
)
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_energy_is_bounded_by_the_image_that_dims_the_albedo():
    dim = np.full((2, 2, 3), 0.5)
    assert Material("m", (1.0, 1.0, 1.0), dim, glossy=Glossy((0.5, 0.5, 0.5)))
    with pytest.raises(SceneError, match="more than arrives"):
        Material("m", (1.0, 1.0, 1.0), 1.2 * dim, glossy=Glossy((0.5, 0.5, 0.5)))


def test_images_without_texture_coordinates_are_refused_by_name():
    scene = scene_of(Material("m", glossy=Glossy(roughness_image=ROUGHNESS), normal_image=FLAT))
    scene = replace(scene, mesh=replace(scene.mesh, uv=None))
    for look, what in ((scene.glossy_at, "a roughness image"), (scene.shading_normal_at, "a normal image")):
        with pytest.raises(SceneError, match=f"'m' has {what} but scene 'squares' has no texture coordinates"):
            look(*some_points(scene))


def test_a_flat_normal_image_leaves_the_normal_alone():
    scene = scene_of(Material("a", normal_image=FLAT), Material("b"))
    face, barycentric = some_points(scene)
    np.testing.assert_allclose(scene.shading_normal_at(face, barycentric), scene.mesh.normals[face], atol=1e-15)


@pytest.mark.parametrize("mirror", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
@pytest.mark.parametrize("skew", [0.0, 0.7])
def test_normals_tilt_towards_growing_texture_coordinates(mirror: tuple[int, int], skew: float):
    """The gradient of u, orthonormalised, is where x tilts, and y to the side on which v grows."""
    plain = scene_of(Material(normal_image=np.tile([0.6, 0.3, 1.0], (2, 2, 1))))
    turn = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    uv = (plain.mesh.triangles[..., :2] * mirror) @ np.array([[1.0, 0.0], [skew, 1.0]])
    scene = replace(plain, mesh=replace(plain.mesh, vertices=plain.mesh.vertices @ turn.T, uv=uv))
    face, barycentric = some_points(scene)
    local = scene.shading_normal_at(face, barycentric) @ turn
    # u = m₀ x + skew m₁ y and v = m₁ y: along u at constant v is ±x; across, where v grows, ±y.
    expected = np.array([0.6 * mirror[0], 0.3 * mirror[1], 1.0])
    np.testing.assert_allclose(local, np.tile(expected / np.linalg.norm(expected), (len(face), 1)), atol=1e-12)


def test_steep_normals_stay_in_front_and_degenerate_coordinates_tilt_nothing():
    steep = Material(normal_image=np.tile([1e6, 0.0, 1.0], (2, 2, 1)))
    scene = scene_of(steep)
    face, barycentric = some_points(scene)
    normals = scene.shading_normal_at(face, barycentric)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)
    assert np.einsum("pd,pd->p", normals, scene.mesh.normals[face]).min() > 0.009
    collapsed = scene_of(steep, uv=np.zeros((2, 3, 2)))
    np.testing.assert_array_equal(collapsed.shading_normal_at(face, barycentric), collapsed.mesh.normals[face])


def test_hash_covers_what_is_there_and_nothing_else():
    # As it was before materials could be glossy: datasets baked then are still found.
    assert load_scene("two-plates").hash == "073b323ec7a29bd52087eb874379141cccca55310dc1344439e16da6a54c7c4a"
    lobe = Glossy((0.2, 0.2, 0.2), 20.0)
    variants = [
        Material(),
        Material(glossy=lobe),
        Material(glossy=replace(lobe, exponent=21.0)),
        Material(glossy=replace(lobe, specular=(0.2, 0.2, 0.3))),
        Material(glossy=replace(lobe, roughness_image=ROUGHNESS)),
        Material(glossy=replace(lobe, roughness_image=ROUGHNESS.T)),
        Material(normal_image=NORMALS),
        Material(glossy=lobe, normal_image=NORMALS),
        Material(glossy=lobe, normal_image=FLAT),
    ]
    assert len({scene_of(material).hash for material in variants}) == len(variants)
    assert scene_of(Material(glossy=Glossy((0, 0, 0), 20))).hash == scene_of(Material(glossy=Glossy((0.0,) * 3))).hash


def test_a_coloured_lobe_is_not_achromatic():
    assert scene_of(Material(glossy=Glossy((0.2, 0.2, 0.2)))).achromatic
    assert not scene_of(Material(glossy=Glossy((0.2, 0.2, 0.3)))).achromatic


def test_a_stored_scene_is_read_back_whole(tmp_path: Path):
    scene = scene_of(
        Material("plain"),
        Material("rough", glossy=Glossy((0.1, 0.2, 0.3), 7.5, ROUGHNESS)),
        Material("bumpy", image=np.full((2, 2, 3), 0.5), two_sided=True, glossy=Glossy(), normal_image=NORMALS),
    )
    write_scene(zarr.open_group(tmp_path / "s.zarr", mode="w"), scene)
    read = read_scene(zarr.open_group(tmp_path / "s.zarr", mode="r"))
    assert read.hash == scene.hash
    assert [m.glossy is None for m in read.materials] == [True, False, False]
    points = some_points(scene)
    for name in ("albedo_at", "shading_normal_at"):
        np.testing.assert_array_equal(getattr(read, name)(*points), getattr(scene, name)(*points))
    for ours, theirs in zip(read.glossy_at(*points), scene.glossy_at(*points), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_diffuse_store_is_what_it_was(tmp_path: Path):
    """Names and attributes, so that either version reads the other's."""
    group = zarr.open_group(tmp_path / "s.zarr", mode="w")
    write_scene(group, load_scene("two-plates"))
    child = group["scene"]
    assert isinstance(child, zarr.Group)
    assert set(child.array_keys()) == {"vertices", "faces", "material"}
    assert "glossy" not in str(child.attrs["description"])
    assert isinstance(read_scene(group).mesh, Mesh)
