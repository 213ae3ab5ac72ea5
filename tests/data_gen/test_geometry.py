"""Building, repairing and doubling meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from data_gen.geometry import (
    Part,
    assemble,
    box,
    clustered,
    is_closed,
    quad,
    repair,
    rotation_about,
    subdivided,
    with_both_sides,
)
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.scene import Camera, Material, Mesh, Scene

SQUARE = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 0)


def mesh_of(vertices, faces):
    return Mesh(np.array(vertices, float), np.array(faces).reshape(-1, 3), np.zeros(len(faces), int))


def test_box_is_closed_with_normals_outward():
    part = box((1, 2, 3), 0)
    mesh = assemble([part])
    assert is_closed(part)
    assert mesh.areas.sum() == pytest.approx(2 * (2 * 4 + 2 * 6 + 4 * 6))
    assert np.all(np.einsum("fd,fd->f", mesh.normals, mesh.triangles.mean(axis=1)) > 0)


def test_a_sheet_and_a_box_without_a_side_are_open():
    assert not is_closed(SQUARE)
    part = box((1, 1, 1), 0)
    assert not is_closed(Part(part.vertices, part.faces[:-1], 0))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rotation_is_right_handed(axis):
    turned = rotation_about(axis, 90.0) @ np.eye(3)[(axis + 1) % 3]
    assert np.allclose(turned, np.eye(3)[(axis + 2) % 3])


def test_degenerate_triangles_are_dropped_with_a_count():
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0)]
    mesh, notes = repair(mesh_of(vertices, [(0, 1, 2), (0, 1, 1), (0, 1, 3)]), "mesh")
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert notes == ("dropped 2 degenerate triangles of 3",)


def test_repair_is_invariant_to_scale():
    """A small triangle is no degenerate triangle."""
    mesh = mesh_of(1e-9 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), [(0, 1, 2)])
    assert repair(mesh, "mesh") == (mesh, ())


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([(0, 0, 0)], [], "no triangles"),
        ([(0, 0, 0)] * 3, [(0, 1, 2)], "zero extent.*Draco"),
        ([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [(0, 1, 2)], "zero area"),
        ([(0, 0, 0), (1, 0, 0), (0, np.nan, 0)], [(0, 1, 2)], "1 vertices that are not finite"),
        ([(0, 0, 0), (1, 0, 0), (0, np.inf, 0)], [(0, 1, 2)], "not finite"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3)], "outside 0 to 2"),
    ],
)
def test_defects_are_refused(vertices, faces, message):
    with pytest.raises(SceneError, match=message):
        repair(mesh_of(vertices, faces), "mesh")


def test_both_sides_of_a_sheet_are_found_by_rays_from_either_side():
    material = Material(two_sided=True)
    mesh = with_both_sides(assemble([SQUARE]), [material])
    assert len(mesh.faces) == 4
    tracer = Tracer(Scene("sheet", mesh, (material,), Camera((0, 0, 1), (0, 0, 0))))
    origins = np.random.default_rng(0).uniform(0.1, 0.9, (500, 3)) * (1, 1, 0)
    for side in (1.0, -1.0):
        hits = tracer.intersect(origins + np.array((0, 0, 2 * side)), np.tile((0, 0, -side), (500, 1)))
        assert np.all(hits.front)
        assert np.all((hits.face < 2) == (side > 0))


def test_one_sided_faces_get_no_second_side():
    mesh = with_both_sides(assemble([SQUARE, box((1, 1, 1), 1)]), [Material(two_sided=True), Material()])
    assert len(mesh.faces) == 2 + 12 + 2
    assert np.all(mesh.material[-2:] == 0)


def test_sides_that_the_mesh_already_has_are_separated_not_doubled():
    back = Part(SQUARE.vertices, SQUARE.faces[:, ::-1], 0)
    mesh = with_both_sides(assemble([SQUARE, back]), [Material(two_sided=True)])
    assert len(mesh.faces) == 4
    assert np.all(mesh.triangles[:2, :, 2] == 0)
    assert np.all(mesh.triangles[2:, :, 2] < 0)


def test_texture_coordinates_follow_the_corners_of_the_second_side():
    uv = SQUARE.vertices[SQUARE.faces][..., :2]
    mesh = with_both_sides(assemble([Part(SQUARE.vertices, SQUARE.faces, 0, uv)]), [Material(two_sided=True)])
    assert np.allclose(mesh.uv, mesh.triangles[..., :2])


def test_stray_vertices_do_not_widen_the_scene():
    mesh = mesh_of([(0, 0, 0), (1, 0, 0), (0, 2, 0), (50, 50, 50)], [(0, 1, 2)])
    scene = Scene("stray", mesh, (Material(),), Camera((0, 0, 1), (0, 0, 0)))
    assert scene.bounds.tolist() == [[0, 0, 0], [1, 2, 0]]
    assert scene.extent == pytest.approx(5**0.5)


@given(seed=st.integers(0, 1000), longest=st.floats(0.05, 3.0))
@settings(max_examples=30, deadline=None)
def test_subdivision_keeps_the_surface(seed, longest):
    """Areas, normals, materials and texture coordinates of what was there, in triangles without T-junctions."""
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(12, 3)) * (1, 1, 0.3))
    faces = np.array(hull.faces)
    corners = np.asarray(hull.vertices)[faces]
    uv = corners @ rng.normal(size=(3, 2))  # affine, so that each new corner's is known
    mesh = Mesh(np.array(hull.vertices, float), faces, rng.integers(0, 3, len(faces)), uv)
    fine = subdivided(mesh, longest)
    edges = np.linalg.norm(fine.triangles - np.roll(fine.triangles, 1, axis=1), axis=2)
    assert edges.max() <= longest
    assert is_closed(Part(fine.vertices, fine.faces, 0))  # a T-junction would leave an edge with one face
    for index in range(3):
        before, after = (
            np.einsum("f,fd->d", m.areas[m.material == index], m.normals[m.material == index] ** 2)
            for m in (mesh, fine)
        )
        np.testing.assert_allclose(after, before, atol=1e-12)
    matrix = np.linalg.lstsq(corners.reshape(-1, 3), uv.reshape(-1, 2), rcond=None)[0]
    np.testing.assert_allclose(fine.uv, fine.triangles @ matrix, atol=1e-9)
    behind = np.linalg.norm(fine.triangles.mean(axis=1)[:, None] - np.asarray(hull.triangles_center)[None], axis=2)
    assert behind.min(axis=1).max() < np.linalg.norm(np.ptp(fine.vertices, axis=0))


def test_parts_that_touch_are_halved_alike():
    """Two squares with vertices of their own meet in an edge; a third has other edges."""
    wall = quad([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], 0)
    fine = subdivided(assemble([SQUARE, wall, quad([(0, 0, 5), (3, 0, 5), (3, 0.1, 5), (0, 0.1, 5)], 0)]), 0.2)
    along = [
        np.unique(fine.triangles[inside].reshape(-1, 3), axis=0)
        for inside in (fine.triangles[..., 2].max(1) == 0, fine.triangles[..., 1].max(1) == 0)
    ]
    shared = [points[np.all(points[:, 1:] == 0, axis=1)] for points in along]
    assert len(shared[0]) == 9
    np.testing.assert_array_equal(*shared)


def test_a_fine_enough_mesh_is_left_alone_and_no_length_is_refused():
    mesh = assemble([SQUARE])
    np.testing.assert_array_equal(subdivided(mesh, 2.0).triangles, mesh.triangles)
    with pytest.raises(SceneError, match="length above zero"):
        subdivided(mesh, 0.0)


def test_clustering_keeps_closed_surfaces_closed():
    torus = trimesh.creation.torus(1.0, 0.3, major_sections=96, minor_sections=48)
    vertices, faces = clustered(np.array(torus.vertices), np.array(torus.faces), 400)
    coarse = trimesh.Trimesh(vertices, faces, process=False)
    assert coarse.is_watertight
    assert coarse.is_winding_consistent
    assert coarse.euler_number == 0  # one handle, as before
    assert 300 < len(vertices) < 500
    assert coarse.volume == pytest.approx(torus.volume, rel=0.03)
    assert repair(Mesh(vertices, faces, np.zeros(len(faces), int)), "torus")[1] == ()


def test_clustering_keeps_two_close_sheets_apart():
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60)), -1).reshape(-1, 2)
    row = (np.arange(59)[:, None] * 60 + np.arange(59)).reshape(-1)
    up = np.concatenate([np.stack([row, row + 1, row + 61], 1), np.stack([row, row + 61, row + 60], 1)])
    vertices = np.concatenate([np.c_[grid, np.full(3600, 0.01)], np.c_[grid, np.full(3600, -0.01)]])
    found, faces = clustered(vertices, np.concatenate([up, up[:, ::-1] + 3600]), 200)
    assert set(np.round(found[:, 2], 12)) == {0.01, -0.01}
    normal = Mesh(found, faces, np.zeros(len(faces), int)).normals[:, 2]
    assert np.all(np.sign(normal) == np.sign(found[faces][:, 0, 2]))
