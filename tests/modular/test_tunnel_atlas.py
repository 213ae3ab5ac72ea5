"""A tunnel's light as an image and in OpenGL: lookups go on across seams, and frames have the operator's light."""

import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.direct import direct_irradiance
from data_gen.tracer import Tracer
from data_gen.tunnels import EDGE, scene_of, tunnel_samples
from prt_bench.errors import AssetError, RuntimeUnavailable, SpecError
from prt_bench.lights import Lighting, PointLight, emitters
from prt_bench.modular.tunnel import Tunnel, transfer
from prt_bench.modular.tunnel_atlas import TunnelAtlas
from prt_bench.runtime import headless
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera, Mesh

from .test_atlas import lookup

SIDE = 16
PATH, RING = Tunnel(("straight", "left", "right", "straight", "right")), Tunnel(("right",) * 4)
WALLS, FLOOR = ((0.7, 0.6, 0.5), (0.3, 0.5, 0.7)), (0.5, 0.4, 0.3)
LIGHT = Lighting([PointLight((1.2, 0.4, 0.3), (9.0, 8.0, 7.0)), PointLight((3.8, -0.5, -3.0), (5.0, 9.0, 4.0))])


@pytest.mark.parametrize("tunnel", [PATH, RING], ids=["open", "ring"])
def test_a_lookup_anywhere_on_the_wall_is_the_interpolation(tunnel):
    atlas, light = TunnelAtlas(tunnel, SIDE), np.random.default_rng(0).random(len(tunnel.pieces) * SIDE**2)
    image = np.where(atlas.source < 0, np.nan, light[atlas.source]).reshape(atlas.resolution, -1)
    mesh = scene_of(tunnel).mesh
    found = lookup(image, atlas.lightmap(mesh, EDGE).corner_uv.reshape(-1, 2))
    corners = mesh.triangles.reshape(-1, 3) / EDGE
    # Just within its own piece, for at a seam a corner belongs to either.
    middle = np.repeat(mesh.triangles.mean(axis=1) / EDGE, 3, axis=0)
    wanted = tunnel.interpolation(corners + 1e-7 * (middle - corners), SIDE) @ light
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_meshes_that_are_not_of_the_tunnel_are_refused():
    atlas, mesh = TunnelAtlas(PATH, SIDE), scene_of(PATH).mesh
    with pytest.raises(SpecError, match="no piece"):
        atlas.lightmap(Mesh(mesh.vertices + np.full(3, 9.0), mesh.faces, mesh.material), EDGE)
    ends = [PATH.place(piece, np.array([along]), np.array([0.2]))[0] for piece, along in ((0, 0.7), (0, 0.8), (1, 0.4))]
    with pytest.raises(SpecError, match="cut the mesh where its pieces meet"):
        atlas.lightmap(Mesh(EDGE * np.concatenate(ends), np.array([[0, 1, 2]]), np.array([0])), EDGE)


@pytest.fixture(scope="module")
def gl():
    try:
        return headless()
    except RuntimeUnavailable as error:
        pytest.skip(str(error))


@pytest.mark.gl
def test_opengl_is_the_operator_of_the_tunnel(gl, pipes):
    points, operator = tunnel_samples(PATH, SIDE, WALLS, FLOOR), transfer(PATH, pipes)
    scene = scene_of(PATH, WALLS, FLOOR)
    runtime = LevelRuntime(TunnelAtlas(PATH, SIDE), operator, scene, points, EDGE, (64, 64), 1024)
    direct, found = runtime.solve(LIGHT, 3)
    albedo = jnp.asarray(points.albedo.reshape(found.shape), jnp.float32)
    wanted = np.asarray(operator(jnp.asarray(direct), albedo, 3))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())
    traced = direct_irradiance(Tracer(scene), points, emitters([LIGHT]))[0].reshape(found.shape)
    wanted = np.asarray(operator(jnp.asarray(traced), albedo, 3))
    assert np.linalg.norm(found - wanted) < 0.01 * np.linalg.norm(wanted)
    # The wall at the seam of the first two pieces, seen from its middle.
    runtime.look_from(Camera((0.5 * EDGE, 0.0, 0.0), (0.5 * EDGE, 0.0, 1.0), fov_y=2.0))
    shown = runtime.frame(LIGHT, 3, direct=False)[31:33, 31:33].mean((0, 1))
    near = PATH.interpolation(np.array([[0.5, 0.0, 0.3]]), SIDE) @ found.reshape(-1, 3)
    halves = 0.5 * (np.array(WALLS[0]) + WALLS[1]) / np.pi * near[0]
    np.testing.assert_allclose(shown, halves, rtol=0.02)
    with pytest.raises(AssetError, match="does not fit"):
        LevelRuntime(TunnelAtlas(RING, SIDE), operator, scene, points, EDGE)
