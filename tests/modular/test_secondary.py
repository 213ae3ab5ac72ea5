"""Vector irradiance and irradiance volumes of levels: closed forms, optimality, gathered light, rotations, walls, OpenGL."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.levels import EDGE, block_samples, scene_of
from prt_bench.errors import AssetError, RuntimeUnavailable, SpecError
from prt_bench.irradiance_volume import places
from prt_bench.lights import Lighting, PointLight
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.cube import cosine_rays, frames, interpolation, sample_points
from prt_bench.modular.dictionary import Dictionary
from prt_bench.modular.level import Level, maze, transfer
from prt_bench.modular.level_secondary import open_rooms, probe_volume, slope, turned_places, volume
from prt_bench.modular.rotations import ROTATIONS
from prt_bench.modular.secondary import _hemisphere, from_faces, probed, slopes, tilted
from prt_bench.runtime import headless
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera, Mesh
from prt_bench.spherical.harmonics import bands, evaluate, quadrature
from prt_bench.spherical.zonal import cosine_lobe

from .conftest import SIDE

LIGHT = Lighting([PointLight((0.4, 0.7, 0.3), (9.0, 8.0, 7.0))])


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1, 1.57])
def test_the_slope_of_a_directions_light_is_the_best_there_is(angle):
    normals = _hemisphere(96)
    direction = np.array([0.6 * np.sin(angle), 0.8 * np.sin(angle), np.cos(angle)])
    rest, root = np.maximum(0.0, normals @ direction) - direction[2], normals[:, 2] ** 2
    wanted = np.linalg.lstsq((normals - [0, 0, 1]) * root[:, None], rest * root, rcond=None)[0]
    np.testing.assert_allclose(slopes(direction[None])[0], wanted, atol=5e-4)


def test_even_light_falls_off_with_the_tilt_as_half_a_sky_does():
    """Under radiance 1 from everywhere in front a tilted surface receives π (1 + cos) / 2."""
    _, normal = sample_points(SIDE)
    found = (tilted(SIDE, from_faces(SIDE)) @ np.ones(len(normal))).reshape(-1, 3)
    np.testing.assert_allclose(found, 0.5 * np.pi * normal, atol=0.02)


def as_published(direction: np.ndarray) -> np.ndarray:
    """[R, 4]: irradiance as a + c · m for light from directions before z, by Appendix B of Loos et al. 2011."""
    harmonics = np.asarray(evaluate(direction, 3)) * np.asarray(cosine_lobe(3))[bands(3)]
    c1, c2, c3 = 0.75 * 5**0.5, 0.375 * 5**0.5, 0.5 * 15**0.5
    one, y, z, x, _, yz, zz, xz, _ = harmonics.T
    unit, linear = (1 / (4 * np.pi)) ** 0.5, (3 / (4 * np.pi)) ** 0.5
    return np.stack([unit * (one - c1 * zz), linear * (x + c2 * xz), linear * (y + c2 * yz), linear * (z + c3 * zz)], 1)


@pytest.mark.parametrize("tilt", [0.15, 0.35, 0.6])
def test_tilted_surfaces_receive_what_is_gathered_for_them(tilt):
    """Light that a lamp in the cube leaves on its faces, by rays from some samples, for normals off the face's by `tilt`."""
    position, normal = sample_points(SIDE)
    away = np.array([0.1, 0.3, -0.2]) - position
    radiosity = np.maximum(0, np.sum(away * normal, axis=1)) / np.sum(away**2, axis=1) ** 1.5
    rows, local = np.arange(0, len(position), 7), _hemisphere(64)
    axes = frames(normal[rows])
    rays = np.einsum("rk,nkc->nrc", local, axes)
    seen = interpolation(np.repeat(position[rows], len(local), axis=0), rays.reshape(-1, 1, 3), SIDE) @ radiosity
    seen = 2.0 / len(local) * seen.reshape(len(rows), -1)
    facing = np.random.default_rng(0).standard_normal((100, 3)) * [tilt, tilt, 0.0] + [0.0, 0.0, 1.0]
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    wanted = seen @ np.maximum(0.0, local @ facing.T)
    flat = seen @ local[:, 2]
    change = (tilted(SIDE, from_faces(SIDE)) @ radiosity / np.pi).reshape(-1, 3)[rows]
    found = flat[:, None] + np.einsum("nc,nkc,jk->nj", change, axes, facing - [0.0, 0.0, 1.0])
    published = seen @ as_published(local)
    published = published[:, :1] + published[:, 1:] @ facing.T
    error, scalar, theirs = (
        np.linalg.norm(each - wanted) / np.linalg.norm(wanted) for each in (found, flat[:, None], published)
    )
    assert error < 0.15 * scalar
    assert error < 0.6 * theirs, (error, theirs)


def test_probes_in_a_cube_have_the_light_that_is_gathered_there():
    """Harmonics of the irradiance that rays about each of many normals gather."""
    position, _ = sample_points(SIDE)
    radiosity = 1.0 + position @ [0.5, -1.0, 0.3]
    at, (facing, weight) = places(np.full(3, -0.5), np.full(3, 0.5), (2, 2, 2)), quadrature(12)
    facing = np.asarray(facing)
    matrix = np.asarray(evaluate(facing, 3)).T * np.asarray(weight)
    rays = cosine_rays(facing, 48)
    gathered = [interpolation(np.tile(place, (len(rays), 1)), rays, SIDE) @ radiosity / 48**2 for place in at]
    wanted = np.stack(gathered) @ matrix.T
    found = (probed(2, from_faces(SIDE)) @ radiosity / np.pi).reshape(8, 9)
    np.testing.assert_allclose(found, wanted, atol=0.003 * wanted.max())
    single = probe_volume(Level(((0, 0),)), jnp.asarray(found)[None, :, :, None], 1.0)
    shown = single.irradiance(jnp.asarray(at), jnp.tile(jnp.array([0.0, 0.0, 1.0]), (8, 1)))[0, :, 0]
    np.testing.assert_allclose(shown, found @ np.asarray(evaluate(np.array([0.0, 0.0, 1.0]), 3)), rtol=1e-6)


def test_light_between_blocks_tilts_and_fills_the_air_as_in_one_long_room(dictionary):
    """Two blocks open to each other against rays through the room that both are: light leaves one and enters the other."""
    level = Level(((0, 0), (1, 0)))
    operator = transfer(level, dictionary)
    place, normal = level.points(SIDE)
    solid = np.asarray(operator.solid)
    radiosity = np.where(place[0, :, 1] > 0.49, 1.0 + place[0, :, 2], 0.3) * solid[0]
    light = jnp.zeros((2, len(normal), 1), jnp.float32).at[0, :, 0].set(jnp.asarray(radiosity, jnp.float32))
    b = operator.coefficients(light)
    r = operator.arriving(b)
    air = probe_volume(level, volume(operator, b, r), 1.0)

    def gathered(at: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Mean radiosity over rays from the second block that go into the first and meet a face there."""
        count, number = rays.shape[:2]
        start, way = np.repeat(at, number, axis=0), rays.reshape(-1, 3)
        with np.errstate(divide="ignore"):
            share = (0.5 - start[:, 0]) / way[:, 0]
        door = start + np.where(way[:, 0] < 0, share, 0.0)[:, None] * way
        through = (way[:, 0] < 0) & (np.abs(door[:, 1:]) <= 0.5).all(axis=1)
        seen = np.zeros(len(way))
        seen[through] = interpolation(np.clip(door[through], -0.5, 0.5), way[through, None], SIDE) @ radiosity
        return seen.reshape(count, number).mean(axis=1)

    at = np.array([[0.8, 0.1, -0.2], [1.1, -0.2, 0.2], [0.9, 0.3, 0.0]])
    for facing in ([-1.0, 0.0, 0.0], [-0.6, 0.8, 0.0], [-0.6, 0.0, -0.8]):
        normals = np.tile(facing, (3, 1))
        wanted = gathered(at, cosine_rays(normals, 64))
        found = np.asarray(air.irradiance(jnp.asarray(at), jnp.asarray(normals)))[0, :, 0]
        np.testing.assert_allclose(found, wanted, rtol=0.25, atol=0.02)
    change = np.asarray(slope(operator, b, r))[1, :, :, 0]
    rows = np.flatnonzero((place[1, :, 0] < 1.2) & (normal[:, 1] > 0.9) & (solid[1] > 0))  # the floor near the opening
    facing = np.tile([-0.6, 0.8, 0.0], (len(rows), 1))
    rays = cosine_rays(facing, 48)
    wanted = gathered(place[1, rows], rays)
    flat = np.asarray(operator.indirect(b, r))[1, rows, 0]
    found = flat + np.sum(change[rows] * (facing - normal[rows]), axis=1)
    assert np.linalg.norm(found - wanted) < 0.2 * np.linalg.norm(wanted)
    assert np.linalg.norm(found - wanted) < 0.4 * np.linalg.norm(flat - wanted)


@pytest.mark.parametrize(
    ("rotation", "kind", "most"),
    [(5, "dictionary", 1e-5), (1, "dictionary", 1e-5), (22, "spatial", 0.1)],
)
def test_a_level_that_is_turned_has_turned_vectors_and_volumes(rotation, kind, most, request):
    """To rounding about +y; a dictionary of three dimensions favours directions a little."""
    blocks = request.getfixturevalue(kind)
    level, matrix = Level(((0, 0), (1, 0), (1, 1))), ROTATIONS[rotation]
    other = Level(tuple(tuple((matrix @ cell).tolist()) for cell in level.cells))
    one, two = transfer(level, blocks, tolerance=0.0), transfer(other, blocks, tolerance=0.0)
    light = np.repeat(np.random.default_rng(0).random((3, 6)), SIDE**2, axis=1).astype(np.float32)
    light = (light * np.asarray(one.solid))[..., None]
    order = np.asarray(one.turns)[rotation]
    first, second = ((each, *each.bounced(jnp.asarray(x), 1.0)) for each, x in ((one, light), (two, light[:, order])))
    wanted = np.einsum("ij,nsjc->nsic", matrix, np.asarray(slope(*first))[:, order])
    assert np.linalg.norm(slope(*second) - wanted) < most * np.linalg.norm(wanted)
    at, facing = np.array([[0.1, 0.2, -0.3], [0.7, -0.1, 0.1]]), np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    air = [probe_volume(each, volume(*parts), 1.0) for each, parts in ((level, first), (other, second))]
    found = [
        np.asarray(each.irradiance(jnp.asarray(at @ turn.T), jnp.asarray(facing @ turn.T)))
        for each, turn in zip(air, (np.eye(3), matrix), strict=True)
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=max(most, 1e-4))
    np.testing.assert_array_equal(np.sort(turned_places(3), axis=1), np.tile(np.arange(27), (24, 1)))


def test_walls_keep_light_of_the_next_room_out_of_the_air():
    wall = frozenset({frozenset({(0, 0), (1, 0)})})
    walled, opened = Level(((0, 0), (1, 0)), wall), Level(((0, 0), (1, 0)))
    filled = jnp.zeros((2, 8, 9, 1)).at[1, :, 0].set(1.0)
    near = jnp.array([[0.49, 0.0, 0.0]])
    up = jnp.array([[0.0, 1.0, 0.0]])
    dark, mixed = (float(probe_volume(level, filled, 1.0).irradiance(near, up)[0, 0, 0]) for level in (walled, opened))
    assert dark == 0.0
    np.testing.assert_allclose(mixed, 0.48 * 0.28209479, rtol=1e-3)
    around = open_rooms(Level(((0, 0), (1, 0), (1, 1), (0, 1)), frozenset({frozenset({(0, 0), (1, 0)})})))
    corner = 9 * 2 + 3 * 1 + 2
    assert around[0] >> corner & 1, "the room across is seen past the other one"
    assert not around[0] >> (9 * 2 + 3 * 1 + 1) & 1, "the room behind the wall is not"


def test_a_dictionary_keeps_them_and_one_without_says_so(tmp_path, dictionary):
    found = Dictionary.load(dictionary.save(tmp_path / "blocks.safetensors"))
    for name in ("tilt", "tilt_arriving", "probes", "probes_arriving"):
        np.testing.assert_array_equal(getattr(found.secondary, name), getattr(dictionary.secondary, name))
    plain = eqx.tree_at(lambda each: each.secondary, dictionary, None)
    assert Dictionary.load(plain.save(tmp_path / "plain.safetensors")).secondary is None
    operator = transfer(Level(((0, 0),)), plain)
    with pytest.raises(SpecError, match="secondary=True"):
        slope(operator, *operator.bounced(jnp.ones((1, operator.solid.shape[1], 1)), 1.0))


@pytest.fixture(scope="module")
def level():
    return maze(4, seed=1)


@pytest.fixture(scope="module")
def runtime(level, dictionary):
    try:
        headless()
    except RuntimeUnavailable as error:
        pytest.skip(str(error))
    operator = transfer(level, dictionary)
    points = block_samples(level, SIDE, ((0.7, 0.6, 0.5),) * 6)
    scene = scene_of(level, ((0.7, 0.6, 0.5),) * 6, bumps=np.dstack(np.broadcast_arrays(0.5, 0.0, np.ones((2, 2)))))
    return operator, points, LevelRuntime(LevelAtlas(level, SIDE), operator, scene, points, EDGE, (64, 64), 512)


@pytest.mark.gl
def test_vectors_and_volumes_are_those_of_jax(level, runtime):
    operator, points, drawn = runtime
    direct, light = drawn.solve(LIGHT, 2)
    probes = drawn.probes()
    probes.prepare(drawn.light(LIGHT))
    albedo = jnp.asarray(points.albedo.reshape(light.shape), jnp.float32) * operator.solid[:, :, None]
    b, r = operator.bounced(jnp.asarray(direct), albedo, 2)
    wanted = np.asarray(slope(operator, b, r))
    np.testing.assert_allclose(drawn.slopes(), wanted, atol=1e-5 * np.abs(wanted).max())
    air = probe_volume(level, volume(operator, b, r), EDGE)
    np.testing.assert_allclose(probes.read(), air.coefficients[0], atol=1e-5 * float(air.coefficients.max()))


@pytest.mark.gl
def test_a_bumpy_floor_shows_the_light_of_its_normal(level, runtime):
    """The image tilts every face by atan 0.5 along u, which on floors is +z."""
    _, _, drawn = runtime
    _, light = drawn.solve(LIGHT, 2)
    found = drawn.slopes()
    floor = 3 * SIDE**2 + np.arange(SIDE**2)
    middle = floor.reshape(SIDE, SIDE)[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1].ravel()
    tangent = drawn.scene.tangent_frames(np.arange(len(drawn.scene.mesh.faces)))
    face = int(np.flatnonzero(drawn.scene.mesh.normals[:, 1] > 0.9)[0])
    facing = (tangent[face, 2] + 0.5 * tangent[face, 0]) / np.sqrt(1.25)
    change = np.einsum("skc,k->sc", found[0], facing - [0.0, 1.0, 0.0])
    wanted = (light[0] + change)[middle].mean(0)
    x, _, z = EDGE * np.array(level.cells[0], float)
    drawn.look_from(Camera((x, 0.3, z), (x, -1.0, z), up=(0.0, 0.0, 1.0), fov_y=2.0))
    shown = drawn.frame(LIGHT, 2, direct=False)[31:33, 31:33].mean((0, 1))
    np.testing.assert_allclose(shown, np.array([0.7, 0.6, 0.5]) / np.pi * wanted, rtol=0.01)
    assert np.max(np.abs(change)) > 0.02 * light[0].max()


@pytest.mark.gl
def test_a_body_is_lit_by_the_air_around_it(level, runtime):
    """A small square in the first room that faces the camera, under indirect light alone."""
    operator, points, drawn = runtime
    direct, light = drawn.solve(LIGHT, 2)
    albedo = jnp.asarray(points.albedo.reshape(light.shape), jnp.float32) * operator.solid[:, :, None]
    air = probe_volume(level, volume(operator, *operator.bounced(jnp.asarray(direct), albedo, 2)), EDGE)
    at = EDGE * np.array(level.cells[0], float) + [0.1, 0.2, -0.3]
    corners = 0.3 * np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1.0]])
    pose = np.eye(4)
    pose[:3, 3] = at
    body = drawn.body(
        Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, int)), (0.5, 0.5, 0.5), drawn.probes()
    )
    body.move(pose)
    above = at + np.array([0.0, 0.5, 0.0])
    drawn.look_from(Camera(tuple(above), tuple(at), up=(0.0, 0.0, 1.0), fov_y=4.0))
    shown = drawn.frame(LIGHT, 2, direct=False, bodies=[body])[31:33, 31:33].mean((0, 1))
    wanted = air.irradiance(jnp.asarray(at[None]), jnp.array([[0.0, 1.0, 0.0]]))[0, 0]
    np.testing.assert_allclose(shown, 0.5 / np.pi * np.asarray(wanted), rtol=0.01)


@pytest.mark.gl
def test_without_normal_images_nothing_of_it_is_compiled(level, runtime):
    """A level whose scene is flat has the light of one without, to the bit, and refuses to tell its vectors."""
    operator, points, drawn = runtime
    flat = LevelRuntime(
        LevelAtlas(level, SIDE), operator, scene_of(level, ((0.7, 0.6, 0.5),) * 6), points, EDGE, (64, 64), 512
    )
    np.testing.assert_array_equal(flat.solve(LIGHT, 2)[1], drawn.solve(LIGHT, 2)[1])
    assert flat.atlas.layers == 1
    with pytest.raises(AssetError, match="normal images"):
        flat.slopes()
