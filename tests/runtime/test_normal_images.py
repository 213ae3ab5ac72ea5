"""Normal images enter bake, transfer and frame alike: a tilted plane against closed forms and quadrature."""

from dataclasses import replace

import numpy as np
import pytest

import prt_bench as prt
from data_gen.atlas import surface_points
from data_gen.geometry import assemble, quad
from data_gen.glossy_reference import reference_radiance
from data_gen.reference import direct_irradiance, indirect_irradiance
from prt_bench.environment import EnvironmentMap
from prt_bench.methods.escaping import transfer_vectors
from prt_bench.runtime import Runtime
from prt_bench.scene import Camera, Glossy, Material, Mesh, Scene
from prt_bench.spherical import evaluate, quadrature

TILT = np.array([0.3, -0.2, 1.0])
LIGHT = prt.DirectionalLight((0.4, -1.0, 0.3), (3.0, 2.0, 1.0))


def plane(tilt: np.ndarray, **lobe: object) -> Scene:
    """The unit square in the plane y = 0, seen from above; u runs along x, v along −z."""
    mesh = assemble([quad([(0, 0, 1), (1, 0, 1), (1, 0, 0), (0, 0, 0)], 0)])
    corners = mesh.triangles
    uv = np.stack([corners[..., 0], 1.0 - corners[..., 2]], axis=-1)
    shine = Glossy(**lobe) if lobe else None
    material = Material("tilted", (0.4, 0.4, 0.4), normal_image=np.tile(tilt, (4, 4, 1)), glossy=shine)
    camera = Camera((0.5, 2.0, 0.5), (0.5, 0.0, 0.5), up=(0.0, 0.0, -1.0), fov_y=20.0)
    return Scene("tilted", Mesh(mesh.vertices, mesh.faces, mesh.material, uv), (material,), camera)


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    settings = {"lightings": 2, "texels": 16, "rays": 1024, "measurements": 8}
    return prt.bake(plane(TILT), "directional", **settings, out=tmp_path_factory.mktemp("tilted"))


def world(tilt: np.ndarray) -> np.ndarray:
    normal = np.array([tilt[0], tilt[2], -tilt[1]])
    return normal / np.linalg.norm(normal)


def test_direct_light_falls_on_the_tilted_normal(tilted):
    lit = prt.light(tilted, [prt.Lighting([LIGHT])])
    towards = -np.asarray(LIGHT.direction) / np.linalg.norm(LIGHT.direction)
    wanted = np.maximum(world(TILT) @ towards, 0.0) * np.array([3.0, 2.0, 1.0])
    np.testing.assert_allclose(
        lit.direct[0], np.tile(wanted[: lit.direct.shape[2]], (len(tilted.points), 1)), rtol=1e-5
    )
    np.testing.assert_allclose(tilted.points.normal, np.tile(world(TILT), (len(tilted.points), 1)), atol=1e-12)


def test_transfer_is_cut_by_the_surface_itself(tilted):
    """The cosine is about the tilted normal, the horizon that of the plane."""
    directions, weight = quadrature(100)
    seen = np.maximum(directions @ world(TILT), 0.0) * (directions[:, 1] > 0)
    exact = np.einsum("q,q,qk->k", weight, seen, evaluate(directions, 3))
    albedo = np.full((len(tilted.points), 1), 0.4, np.float32)
    direct, indirect = transfer_vectors(tilted.transport, albedo, 3)
    np.testing.assert_allclose(direct.mean(axis=0), exact, atol=0.01)
    assert np.abs(direct - exact).max() < 0.06
    assert np.abs(indirect).max() == 0.0  # a plane sees none of its own light


def test_frames_shade_by_the_tilted_normal(tilted):
    lighting = prt.Lighting([LIGHT])
    frame = Runtime(tilted, size=(32, 32), shadow_resolution=128).frame(lighting)
    wanted = 0.4 / np.pi * prt.light(tilted, [lighting]).direct[0, 0]
    np.testing.assert_allclose(frame[16, 16], np.broadcast_to(wanted, 3) * np.ones(3), rtol=1e-3)


def test_lobes_mirror_about_the_tilted_normal(tmp_path):
    """The lobe is brightest where light comes from the mirror direction of the tilted normal, not of the plane's."""
    settings = {"lightings": 2, "texels": 16, "rays": 64, "measurements": 8}
    ds = prt.bake(plane(TILT, specular=(0.5, 0.5, 0.5), exponent=40.0), "directional", **settings, out=tmp_path)
    window = Runtime(ds, size=(32, 32), shadow_resolution=128)
    shiny, dull = (
        window.load(prt.method(name).fit(ds).export(tmp_path / name)) for name in ("sh-triple", "sh-texture")
    )
    up = np.array([0.0, 1.0, 0.0])
    mirror = 2.0 * (world(TILT) @ up) * world(TILT) - up
    peaks = []
    for towards in (mirror, up):
        lighting = prt.Lighting([prt.DirectionalLight(-towards, (1.0, 1.0, 1.0))])
        peaks.append((window.frame(lighting, shiny) - window.frame(lighting, dull))[16, 16, 0])
    assert peaks[0] > 1.5 * peaks[1]


def test_path_tracers_read_normal_images():
    """Under an even sky: light over the plane's horizon, about the tilted normal; and in a corner with a tilted wall, what the
    bake's rays gather of it. Normals left as they are would give π and another share of the sun."""
    scene = plane(TILT)
    directions, weight = quadrature(200)
    wanted = np.sum(weight * np.maximum(directions @ world(TILT), 0.0) * (directions[:, 1] > 0))
    sky = prt.Lighting([prt.EnvironmentLight(EnvironmentMap("even", np.ones((8, 16, 3), np.float32)))])
    points = surface_points(scene, np.zeros(2, int), np.full((2, 3), 1 / 3))
    flat = scene.mesh.normals[points.face]
    found = direct_irradiance(scene, points.position, points.normal, sky, 200_000, flat=flat)
    np.testing.assert_allclose(found.mean, wanted, rtol=0.01)
    assert abs(wanted / np.pi - 1.0) > 0.02
    up = np.tile([0.0, 1.0, 0.0], (2, 1))
    seen = reference_radiance(scene, sky, points, up, 100_000, 1)
    np.testing.assert_allclose(seen.mean, 0.4 / np.pi * wanted, rtol=0.01)


def test_tilted_walls_send_what_the_bake_has(tmp_path):
    """One bounce from a sunlit plane with a normal image onto a wall above its edge."""
    flat_plane = plane(TILT)
    wall = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 1)
    mesh = assemble([quad([(0, 0, 1), (1, 0, 1), (1, 0, 0), (0, 0, 0)], 0), wall])
    corners = mesh.triangles
    uv = np.stack([corners[..., 0], 1.0 - corners[..., 2]], axis=-1)
    materials = (flat_plane.materials[0], Material("wall", (0.5, 0.5, 0.5)))
    scene = Scene("corner", Mesh(mesh.vertices, mesh.faces, mesh.material, uv), materials, flat_plane.camera)
    ds = prt.bake(scene, "directional", lightings=1, texels=32, rays=1024, measurements=8, out=tmp_path)
    sun = prt.Lighting([prt.DirectionalLight((0.4, -1.0, -0.3), (3.0, 3.0, 3.0))])
    lit = prt.light(ds, [sun])
    chosen = np.flatnonzero((ds.scene.mesh.material[ds.points.face] == 1) & ~ds.transport.buried)[::9]
    points = ds.points[chosen]
    found = indirect_irradiance(scene, points.position, points.normal, sun, 2000).mean
    assert np.linalg.norm(found[:, :1] - lit.indirect[0, chosen]) < 0.05 * np.linalg.norm(found[:, :1])
    straight = replace(scene, materials=(replace(materials[0], normal_image=None), materials[1]))
    other = indirect_irradiance(straight, points.position, points.normal, sun, 2000).mean
    assert abs(found.sum() / other.sum() - 1.0) > 0.1
