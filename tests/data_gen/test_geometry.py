"""Building, repairing and doubling meshes."""

import numpy as np
import pytest

from data_gen.geometry import Part, assemble, box, is_closed, quad, repair, rotation_about, with_both_sides
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
