"""The hull of a scene: surfaces around its bodies where direct light can be measured instead of on them.

For bodies whose own surface is too fine or too ragged to measure on, as hair is. Which points of it are measured at is left
to `sampling.py`.
"""

from dataclasses import replace

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import QhullError

from data_gen.strands import without_strands
from data_gen.tracer import Tracer
from prt_bench.errors import SceneError
from prt_bench.scene import Mesh, Scene
from prt_bench.strands import SIDES

MARGIN = 0.02
"""How far the hull keeps off its body at the corners, relative to the body's extent; elsewhere less."""
_FACET = 0.05
"""Longest edge of the hull's facets, relative to the body's extent: what is hidden is left out facet by facet."""
_BODY = 1e-3
"""A part whose volume is below this fraction of its extent cubed is a sheet, not a body."""

_AXES = np.concatenate([np.eye(3), -np.eye(3)])


def hull_scene(scene: Scene, tracer: Tracer) -> Scene:
    """The scene with each body replaced by the convex hull around it, a little wider; what does not show of it is left out.

    Bodies are connected parts that enclose volume. Sheets, such as a ground plane, and parts that face inward, such as the
    walls of a room, have no hull: they stay as they are, and light is measured on them. Facets within another body's hull,
    inside solid geometry or behind a sheet (where a body stands on the ground) are dropped. Its surface is for measuring
    alone: a facet has the material of one of the faces it stands for, without images. Raises `SceneError` as `check_hull`.
    """
    bodies, kept = _taken_apart(scene)
    return _around(scene, bodies, kept, tracer)


def measuring_scene(scene: Scene, tracer: Tracer) -> Scene:
    """Where direct light is measured on surfaces: the scene itself, with a hull around hair, which has no surface for that."""
    if scene.strands is None:
        return scene
    return _around(scene, _hair_hulls(scene), np.arange(scene.surfaces), tracer)


def _around(
    scene: Scene, bodies: list[tuple[trimesh.Trimesh, int]], kept: Int[np.ndarray, " kept"], tracer: Tracer
) -> Scene:
    """The faces that are `kept`, and hulls around the rest."""
    triangles, material = [scene.mesh.triangles[kept]], [scene.mesh.material[kept]]
    for index, (hull, owner) in enumerate(bodies):
        facets = np.asarray(hull.triangles)[
            _shows(hull, [other for other, _ in bodies[:index] + bodies[index + 1 :]], tracer)
        ]
        triangles.append(facets)
        material.append(np.full(len(facets), owner))
    corners = np.concatenate(triangles)
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), np.concatenate(material))
    materials = tuple(replace(m, image=None) for m in scene.materials)
    return replace(scene, mesh=mesh, materials=materials, strands=None)


def check_hull(scene: Scene) -> None:
    """Raise `SceneError` for a scene without bodies."""
    _taken_apart(scene)


def _taken_apart(scene: Scene) -> tuple[list[tuple[trimesh.Trimesh, int]], Int[np.ndarray, " kept"]]:
    """The hull of each body with a material of its faces, and the faces of everything else."""
    bodies, others = _hair_hulls(scene), [np.zeros(0, int)]
    for faces in _parts(without_strands(scene).mesh) if scene.surfaces else []:
        hull = _hull(scene.mesh.triangles[faces])
        if hull is None:
            others.append(faces)
        else:
            bodies.append((hull, int(scene.mesh.material[faces[0]])))
    if not bodies:
        raise SceneError(
            f"scene '{scene.name}' has no body that a hull could go around, only sheets and walls that face inward;"
            " measure it on the surface"
        )
    return bodies, np.concatenate(others)


def _hair_hulls(scene: Scene) -> list[tuple[trimesh.Trimesh, int]]:
    """The hull around all strands of each material. Strands that lie in a plane have their tubes' hull."""
    strands, found = scene.strands, []
    if strands is None:
        return found
    owner = strands.material[strands.owner]
    for index in np.unique(owner):
        corners = strands.vertices.reshape(-1, SIDES, 3)[owner == index].reshape(-1, 3)
        hull = _widened(corners)
        if hull is None:
            raise SceneError(
                f"the strands of material '{scene.materials[index].name}' have no hull that light could be measured on:"
                " they are too thin for their length"
            )
        found.append((hull, int(index)))
    return found


def _parts(mesh: Mesh) -> list[Int[np.ndarray, " f"]]:
    """Faces of each connected part; faces are connected where they share a corner's position."""
    corner = np.unique(mesh.triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    pairs = np.concatenate([corner[:, :2], corner[:, 1:]])
    count = corner.max() + 1
    _, label = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)
    owner = label[corner[:, 0]]
    return [np.flatnonzero(owner == part) for part in np.unique(owner)]


def _hull(triangles: Float[np.ndarray, "f 3 3"]) -> trimesh.Trimesh | None:
    """The widened convex hull of a body in small facets; None for a sheet and for what faces inward."""
    points = triangles.reshape(-1, 3)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    # The divergence theorem about the middle: a good measure of what an open shell encloses too, negative facing inward.
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    volume = np.sum(np.linalg.det(triangles - middle)) / 6.0
    return None if volume < _BODY * extent**3 else _widened(points)


def _widened(points: Float[np.ndarray, "p 3"]) -> trimesh.Trimesh | None:
    """The convex hull of points, a little wider, in small facets; None where there is none."""
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    try:
        hull = trimesh.convex.convex_hull(points)
        wider = trimesh.convex.convex_hull(hull.vertices + MARGIN * extent * hull.vertex_normals)
    except QhullError:
        return None
    vertices, faces = trimesh.remesh.subdivide_to_size(wider.vertices, wider.faces, _FACET * extent, max_iter=20)[:2]
    return trimesh.Trimesh(vertices, faces, process=False)


def _shows(hull: trimesh.Trimesh, others: list[trimesh.Trimesh], tracer: Tracer) -> Bool[np.ndarray, " f"]:
    """Facets at whose corners the nearest surface, looking around, shows its front, and that no other hull contains."""
    at, count = np.asarray(hull.vertices), len(hull.vertices)
    around = np.concatenate([np.tile(_AXES, (count, 1, 1)), -hull.vertex_normals[:, None]], axis=1)
    hits = tracer.intersect(np.repeat(at, around.shape[1], axis=0), around.reshape(-1, 3))
    distance, front = hits.distance.reshape(count, -1), hits.front.reshape(count, -1)
    nearest = np.argmin(distance, axis=1)[:, None]
    seen = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
    hidden = (seen & ~np.take_along_axis(front, nearest, axis=1))[:, 0] | tracer.inside(at)
    for other in others:
        within = np.ones(count, bool)
        for point, outward in zip(*_planes(other), strict=True):
            within &= (at - point) @ outward < 0.0
        hidden |= within
    return ~np.any(hidden[hull.faces], axis=1)


def _planes(hull: trimesh.Trimesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """A point and the outward normal of each distinct plane of a convex mesh."""
    _, first = np.unique(np.round(hull.face_normals, 9), axis=0, return_index=True)
    return np.asarray(hull.triangles[first, 0]), np.asarray(hull.face_normals[first])
