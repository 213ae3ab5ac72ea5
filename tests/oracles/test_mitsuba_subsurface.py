"""Walks through a medium against mitsuba's volumetric path tracer: a dielectric body, and a lamp that covers a part of it.

The lamp is a shell just outside of the body that shines inward and reflects nothing, so what arrives below it is diffuse and
even, as irradiance at a sample is. What leaves the body is then K times that, and no model of the entry comes between.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from jaxtyping import Bool, Float

from data_gen.medium_walk import Fate, bodies, follow, walk_keys
from data_gen.reference import cosine_directions
from prt_bench.medium import Subsurface, diffuse_reflectance
from prt_bench.scene import Camera, Material, Mesh, Scene
from tests.oracles.mitsuba_oracle import unavailable

pytestmark = pytest.mark.oracle

WALKS = 400_000
PARTS = 3
"""Bands of the body along y, from its lower to its upper end."""


def egg(medium: Subsurface) -> Scene:
    """An ellipsoid twice as high as wide."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.asarray(ball.vertices) * (0.5, 1.0, 0.5)
    mesh = Mesh(vertices, np.asarray(ball.faces), np.zeros(len(ball.faces), int))
    return Scene("egg", mesh, (Material("m", (0, 0, 0), subsurface=medium),), Camera((0, 0, 4), (0, 0, 0)))


def starts(scene: Scene) -> tuple[np.ndarray, ...]:
    """Points all over the surface with directions of the cosine, the band of each, and its face."""
    rng = np.random.default_rng(0)
    area = scene.mesh.areas
    face = rng.choice(len(area), WALKS, p=area / area.sum())
    position = np.einsum("nc,ncd->nd", rng.dirichlet([1, 1, 1], WALKS), scene.mesh.triangles[face])
    normal = scene.mesh.normals[face]
    band = np.clip(((position[:, 1] + 1.0) / 2.0 * PARTS).astype(int), 0, PARTS - 1)
    return position, normal, cosine_directions(rng, normal), band, face


def by_walks(scene: Scene, under_the_lamp: Bool[np.ndarray, " f"]) -> Float[np.ndarray, "PARTS 2"]:
    """Mean of K E in each band for E = 1 under the lamp, and its standard error."""
    position, normal, direction, band, _ = starts(scene)
    ends = follow(bodies(scene)[0], 0, position, normal, direction, walk_keys(np.arange(WALKS), 1, 0)[:, 0])
    return _means((ends.fate == Fate.ESCAPED) & under_the_lamp[ends.face], band)


def by_mitsuba(scene: Scene, under_the_lamp: Bool[np.ndarray, " f"], folder: Path) -> Float[np.ndarray, "PARTS 2"]:
    """Mean radiance that leaves each band under a lamp of radiance 1, without what the boundary reflects of the lamp.

    That is told face by face: faces under the lamp reach over the edge of its band.
    """
    import drjit as dr
    import mitsuba as mi

    medium = scene.materials[0].subsurface
    assert medium is not None
    gap = 6e-4  # of the lamp: mitsuba starts rays some 2e-4 off a surface
    body = trimesh.Trimesh(scene.mesh.vertices, scene.mesh.faces, process=False)
    lamp = trimesh.Trimesh(
        scene.mesh.vertices + gap * body.vertex_normals, scene.mesh.faces[under_the_lamp][:, ::-1], process=False
    )
    described: dict[str, Any] = {"type": "scene"}
    for name, mesh in (("body", body), ("lamp", lamp)):
        mesh.export(folder / f"{name}.ply")
        described[name] = {"type": "ply", "filename": str(folder / f"{name}.ply"), "face_normals": True}
    described["body"]["bsdf"] = {"type": "dielectric", "int_ior": medium.ior, "ext_ior": 1.0}
    described["body"]["interior"] = {
        "type": "homogeneous",
        "sigma_t": float(medium.extinction[0]),
        "albedo": float(medium.albedo[0]),
        "phase": {"type": "hg", "g": medium.anisotropy},
    }
    described["lamp"]["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    described["lamp"]["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    world = mi.load_dict(described)
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 100000})
    position, _, direction, band, face = starts(scene)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, WALKS)
    start, way = mi.Point3f((position + 0.5 * gap * direction).T), mi.Vector3f(-direction.T)
    radiance, _, _ = integrator.sample(world, sampler, mi.RayDifferential3f(start, way))
    dr.eval(radiance)
    return _means(np.asarray(radiance.x) - diffuse_reflectance(medium.ior) * under_the_lamp[face], band)


def _means(values: np.ndarray, band: np.ndarray) -> Float[np.ndarray, "PARTS 2"]:
    parts = [values[band == part].astype(float) for part in range(PARTS)]
    return np.array([(part.mean(), part.std() / np.sqrt(len(part))) for part in parts])


@pytest.mark.parametrize(
    "medium",
    [
        Subsurface((6.0,) * 3, (0.3,) * 3, 0.0, 1.02),
        Subsurface((6.0,) * 3, (0.3,) * 3, 0.6, 1.02),
        Subsurface((6.0,) * 3, (0.3,) * 3, 0.6, 1.5),
    ],
)
def test_walks_agree_with_mitsuba(medium: Subsurface, tmp_path: Path) -> None:
    if reason := unavailable():
        pytest.skip(reason)
    scene = egg(medium)
    under_the_lamp = scene.mesh.triangles[:, :, 1].mean(axis=1) > 1.0 / 3.0  # the upper band
    ours, theirs = by_walks(scene, under_the_lamp), by_mitsuba(scene, under_the_lamp, tmp_path)
    error = np.hypot(ours[:, 1], theirs[:, 1])
    bound = 4 * error + 0.002 * theirs[:, 0]
    assert np.all(ours[:, 0] > 10 * error)  # light comes out on all sides
    assert np.all(np.abs(ours[:, 0] - theirs[:, 0]) < bound)
    other = by_walks(egg(replace(medium, anisotropy=medium.anisotropy - 0.3)), under_the_lamp)
    assert np.any(np.abs(other[:, 0] - theirs[:, 0]) > bound)
