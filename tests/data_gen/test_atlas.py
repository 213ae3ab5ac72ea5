"""The atlas and its texels: charts fit and keep apart, texels cover charts and lie on the surface."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt

from data_gen.atlas import PADDING, lightmap_points, unwrap
from data_gen.geometry import Part, assemble, quad, with_both_sides
from data_gen.raster import rasterise
from data_gen.scenes import load_scene
from prt_bench.errors import SceneError, SpecError
from prt_bench.scene import Camera, Material, Scene

CAMERA = Camera((0, 0, 3), (0, 0, 0))


@pytest.fixture(scope="module", params=["cornell", "suzanne", "two-plates"])
def unwrapped(request):
    scene = load_scene(request.param)
    lightmap = unwrap(scene, 96)
    return scene, lightmap, lightmap_points(scene, lightmap)


def square(uv=None, material=0, x=0.0):
    part = quad([(x, 0, 0), (x + 1, 0, 0), (x + 1, 1, 0), (x, 1, 0)], material)
    return part if uv is None else replace(part, uv=np.asarray(uv, float)[part.faces])


def scene_of(*parts):
    return Scene("parts", assemble(parts), (Material("a"), Material("b")), CAMERA)


def test_unwrapping_is_deterministic(unwrapped):
    scene, lightmap, _ = unwrapped
    again = unwrap(load_scene(scene.name), 96)
    assert np.array_equal(again.corner_uv, lightmap.corner_uv)
    assert np.array_equal(again.texel, lightmap.texel)


def test_charts_are_kept_for_every_resolution(tmp_path, monkeypatch):
    from data_gen import atlas

    scene = load_scene("cornell")
    fresh = {texels: unwrap(scene, texels) for texels in (32, 64)}
    unwrap(scene, 32, tmp_path)
    monkeypatch.setattr(atlas, "_parametrise", None)
    for texels, lightmap in fresh.items():
        kept = unwrap(scene, texels, tmp_path)
        assert np.array_equal(kept.corner_uv, lightmap.corner_uv)
        assert np.array_equal(kept.texel, lightmap.texel)
    assert [path.suffix for path in tmp_path.iterdir()] == [".npz"]
    with pytest.raises(TypeError):  # another scene has charts of its own
        unwrap(load_scene("two-plates"), 32, tmp_path)


def test_every_face_and_chart_has_texels(unwrapped):
    _, lightmap, points = unwrapped
    assert lightmap.chart.min() == 0
    assert np.array_equal(np.unique(lightmap.chart[points.face]), np.unique(lightmap.chart))
    assert lightmap.corner_uv.min() >= 0
    assert lightmap.corner_uv.max() <= 1


def test_points_lie_on_the_surface_inside_their_texel_or_chart(unwrapped):
    scene, lightmap, points = unwrapped
    corners = scene.mesh.triangles[points.face]
    assert points.barycentric.min() > 0
    assert np.allclose(points.barycentric.sum(axis=1), 1)
    assert np.allclose(np.einsum("pc,pcd->pd", points.barycentric, corners), points.position)
    assert np.allclose(np.einsum("pd,pd->p", points.normal, points.position - corners[:, 0]), 0, atol=1e-9)
    place = np.einsum("pc,pcd->pd", points.barycentric, lightmap.corner_uv[points.face]) * lightmap.resolution
    centre = np.stack([lightmap.texel % lightmap.resolution, lightmap.texel // lightmap.resolution], axis=1) + 0.5
    assert np.abs(place - centre).max() < 0.85
    assert np.mean(np.abs(place - centre).max(axis=1) < 0.06) > 0.5  # most are the centre itself


def least_gap(lightmap, points):
    """Empty texels between the two charts that come nearest to each other, along the axis where they are farther apart."""
    chart = lightmap.image(lightmap.chart[points.face].reshape(-1, 1), -1)[..., 0]
    gaps = []
    for own in np.unique(chart[chart >= 0]):
        to_others = distance_transform_cdt((chart < 0) | (chart == own), "chessboard")
        gaps.append(to_others[chart == own].min() - 1)
    return min(gaps)


def test_charts_keep_their_distance(unwrapped):
    _, lightmap, points = unwrapped
    assert least_gap(lightmap, points) >= PADDING


@pytest.mark.parametrize("texture_set", [False, True])
@pytest.mark.parametrize("mips", [1, 2])
def test_halved_images_keep_charts_apart(mips, texture_set):
    """A bilinear lookup in the halved image reads two texels of it, and no two charts share either."""
    scene = load_scene("objects")
    lightmap = unwrap(scene, 256, mips=mips, texture_set=texture_set)
    assert lightmap.mips == mips
    assert least_gap(lightmap, lightmap_points(scene, lightmap)) >= 2 * (2 * 2**mips - 1)


def test_a_texture_set_gives_every_material_a_square():
    scene = load_scene("objects")
    lightmap = unwrap(scene, 192, texture_set=True)
    owner = scene.mesh.material[lightmap_points(scene, lightmap).face]
    column, row = lightmap.texel % 192 // 64, lightmap.texel // 192 // 64
    square = 3 * row + column
    assert all(len(np.unique(square[owner == index])) == 1 for index in np.unique(owner))
    assert len(np.unique(square)) == len(np.unique(owner)) == 6
    areas = np.bincount(scene.mesh.material, scene.mesh.areas)
    texels = np.bincount(owner)
    assert texels.max() / texels.min() < 0.4 * areas.max() / areas.min()


@pytest.mark.parametrize(("texels", "mips"), [(100, 3), (128, 5), (128, -1)])
def test_an_image_that_cannot_be_halved_is_refused(texels, mips):
    with pytest.raises(SpecError, match="mip levels were asked for, but a lightmap of"):
        unwrap(load_scene("cornell"), texels, mips=mips)


def test_squares_without_room_are_refused():
    with pytest.raises(SceneError, match="or fewer mip levels than 3"):
        unwrap(load_scene("objects"), 64, mips=3, texture_set=True)


def test_texels_have_one_size(unwrapped):
    """Area per texel-space area of the charts of large flat faces differs by no more than packing's rounding."""
    scene, lightmap, _ = unwrapped
    flat = np.argsort(scene.mesh.areas)[-4:]
    a, b = (lightmap.corner_uv[flat, i] - lightmap.corner_uv[flat, 0] for i in (1, 2))
    density = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / scene.mesh.areas[flat]
    assert density.max() / density.min() < 1.06


def test_cornell_fills_its_lightmap():
    scene = load_scene("cornell")
    lightmap = unwrap(scene, 128)
    assert 0.62 < len(lightmap.texel) / 128**2 < 0.8
    points = lightmap_points(scene, lightmap)
    red = points.albedo[points.position[:, 0] < -0.999]
    assert np.allclose(red, (0.63, 0.065, 0.05))


def test_charts_never_span_materials(unwrapped):
    scene, lightmap, _ = unwrapped
    for chart in np.unique(lightmap.chart):
        assert len(np.unique(scene.mesh.material[lightmap.chart == chart])) == 1


def test_too_many_charts_for_the_square_is_an_error():
    with pytest.raises(SceneError, match="4² texels; ask for more texels"):
        unwrap(load_scene("cornell"), 4)


def test_both_sides_of_a_sheet_get_texels_of_their_own():
    material = Material(two_sided=True)
    scene = Scene("sheet", with_both_sides(assemble([square()]), [material]), (material,), CAMERA)
    points = lightmap_points(scene, unwrap(scene, 32))
    front = points.normal[:, 2] > 0
    assert 0.4 < front.mean() < 0.6


def test_valid_own_coordinates_are_kept(caplog):
    left = [(0, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)]
    right = [(0.5, 0.5), (0.9, 0.5), (0.9, 0.9), (0.5, 0.9)]
    scene = scene_of(square(left), square(right, material=1, x=3.0))
    with caplog.at_level(logging.INFO):
        lightmap = unwrap(scene, 32)
    assert "keeps its own" in caplog.text
    assert np.array_equal(lightmap.corner_uv, scene.mesh.uv)
    assert lightmap.chart.tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        ([(0, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)], "overlap"),
        ([(0.401, 0), (0.8, 0), (0.8, 0.4), (0.401, 0.4)], "overlap"),  # apart, but in one texel
        ([(0.5, 0.5), (1.1, 0.5), (1.1, 0.9), (0.5, 0.9)], "leave"),
        ([(0.5, 0.5), (0.5, 0.5), (0.5, 0.5), (0.5, 0.5)], "no area"),
    ],
)
def test_invalid_own_coordinates_are_replaced(second, reason, caplog):
    first = [(0, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)]
    with caplog.at_level(logging.INFO):
        lightmap = unwrap(scene_of(square(first), square(second, x=3.0)), 32)
    assert reason in caplog.text
    assert len(np.unique(lightmap.chart)) == 2


def test_lightmap_of_another_scene_is_refused():
    lightmap = unwrap(load_scene("cornell"), 32)
    with pytest.raises(SceneError, match="not made for"):
        lightmap_points(load_scene("two-plates"), replace_texels(lightmap))


def replace_texels(lightmap):
    return type(lightmap)(lightmap.resolution, lightmap.texel[::2], lightmap.corner_uv, lightmap.chart)


def test_conservative_coverage_equals_brute_force_clipping():
    """A texel is covered if and only if clipping the triangle to its square leaves an area."""
    random = np.random.default_rng(3)
    for _ in range(20):
        corners = random.uniform(0.05, 0.95, (1, 3, 2))
        texel, _, _ = rasterise(corners, np.array([True]), 16)
        expected = [t for t in range(256) if clipped_area(corners[0] * 16, t % 16, t // 16) > 1e-3]
        certain = [t for t in range(256) if clipped_area(corners[0] * 16, t % 16, t // 16) > 0]
        assert set(expected) <= set(texel.tolist()) <= set(certain)


def clipped_area(polygon, x, y):
    """Sutherland-Hodgman clipping to the unit square at (x, y)."""
    for axis, sign, bound in ((0, 1, x), (0, -1, -x - 1), (1, 1, y), (1, -1, -y - 1)):
        kept = []
        for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            p_in, q_in = sign * p[axis] - bound, sign * q[axis] - bound
            if p_in >= 0:
                kept.append(p)
            if p_in * q_in < 0:
                kept.append(p + (q - p) * p_in / (p_in - q_in))
        if len(kept) < 3:
            return 0.0
        polygon = np.array(kept)
    u, v = polygon.T
    return 0.5 * abs(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))


def test_uncovered_centre_takes_the_nearest_point_of_the_triangle():
    corners = np.array([[[0.26, 0.26], [0.74, 0.26], [0.26, 0.74]]])
    texel, _, barycentric = rasterise(corners, np.array([True]), 4)
    place = (barycentric @ corners[0]) * 4
    corner_texel = place[texel == 4 * 1 + 2][0]  # its centre (2.5, 1.5) lies 0.0 from the hypotenuse x + y = 4
    assert corner_texel == pytest.approx((2.5, 1.5), abs=0.06)
    beyond = place[texel == 4 * 2 + 2]  # centre (2.5, 2.5) projects to the hypotenuse at (2, 2), which is its corner
    assert len(beyond) == 0


def test_zero_area_faces_in_the_atlas_hold_no_texel():
    flat = Part(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0.0)]), np.array([[0, 1, 2]]), 0, np.zeros((1, 3, 2)))
    texel, face, _ = rasterise(
        np.stack([flat.uv[0], flat.uv[0] + [[0.2, 0], [0, 0.2], [0, 0]]]), np.array([False, True]), 8
    )
    assert len(texel) > 0
    assert np.all(face == 1)
