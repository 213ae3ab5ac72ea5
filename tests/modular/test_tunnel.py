"""Tunnels: where their pieces are, and their light against a traced bake of their mesh, its energy and its mirror image."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.atlas import unwrap
from data_gen.bake import bake
from data_gen.direct import direct_irradiance
from data_gen.scenes import load_scene
from data_gen.scenes.tunnel import PIECES
from data_gen.tracer import Tracer
from data_gen.tunnels import EDGE, scene_of, tunnel_samples
from prt_bench.errors import FitError, SpecError
from prt_bench.lights import Lighting, PointLight, emitters
from prt_bench.metrics import relative_rmse
from prt_bench.modular.pipe import AXIS, BACK, MIRRORED, RADIUS
from prt_bench.modular.pipe_dictionary import PipeDictionary, build
from prt_bench.modular.prepared import PreparedLevel
from prt_bench.modular.tunnel import Tunnel, load_tunnel, random_tunnel, transfer

LEVELS = Path(__file__).parents[2] / "experiments" / "levels"
SIDE = 16
PATH = Tunnel(("straight", "left", "right", "straight", "right"))
RING = Tunnel(("left",) * 4)
AREA = {"straight": 2.0 * np.pi * RADIUS, "left": np.pi**2 * RADIUS * AXIS, "right": np.pi**2 * RADIUS * AXIS}


def lit(tunnel, piece, walls=((0.7, 0.7, 0.7),)):
    """Direct light [N, n, 1] of a lamp off the middle of a piece, shadows traced."""
    position, normal = tunnel.place(piece, np.array([0.4]), np.array([0.3]))
    lighting = Lighting([PointLight(tuple(EDGE * (position + 0.2 * normal)[0]), (20.0, 20.0, 20.0))])
    points = tunnel_samples(tunnel, SIDE, walls)
    direct = direct_irradiance(Tracer(scene_of(tunnel, walls)), points, emitters([lighting]))[0, :, :1]
    return jnp.asarray(direct.reshape(len(tunnel.pieces), -1, 1), jnp.float32), lighting


def flux(tunnel, light):
    """Power on the walls of all pieces, in units of the square of a cell's edge."""
    _, _, share = tunnel.points(SIDE)
    area = np.array([AREA[piece] for piece in tunnel.pieces])[:, None] / SIDE**2 * share
    return float(np.sum(area * np.asarray(light, float)[:, :, 0]))


def test_pieces_follow_each_other_without_a_gap():
    around = np.linspace(0, 1, 13)
    for tunnel in (PATH, RING, random_tunnel(12, seed=3)):
        for piece in range(len(tunnel.pieces)):
            after = tunnel.beside(piece, 1)
            if after is not None:
                ends = [tunnel.place(at, np.full(13, along), around) for at, along in ((piece, 1.0), (after, 0.0))]
                np.testing.assert_allclose(*(np.concatenate(end, axis=1) for end in ends), atol=1e-12)
    assert PATH.cells == [(0, 0), (1, 0), (1, -1), (2, -1), (3, -1)]
    assert (RING.ring, PATH.ring, Tunnel(("straight",)).ring) == (True, False, False)


def test_points_on_the_wall_are_found_and_light_goes_on_across_seams():
    position, _, _ = PATH.points(SIDE)
    flat = position.reshape(-1, 3)
    table = PATH.interpolation(flat, SIDE)
    np.testing.assert_allclose(table @ np.arange(len(flat)), np.arange(len(flat)), atol=1e-6)
    # A smooth function of place is smooth from either side of a seam, and near an end that of the last samples.
    smooth = np.sin(2.0 * flat[:, 0]) + flat[:, 1] - np.cos(1.5 * flat[:, 2])
    along, around = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 7)))
    for piece in range(len(PATH.pieces)):
        place, _ = PATH.place(piece, along, around)
        wanted = np.sin(2.0 * place[:, 0]) + place[:, 1] - np.cos(1.5 * place[:, 2])
        inside = (along > 0.04) | (piece > 0), (along < 0.96) | (piece < len(PATH.pieces) - 1)
        away = np.abs(PATH.interpolation(place, SIDE) @ smooth - wanted)
        assert away[np.logical_and(*inside)].max() < 0.02
        assert away.max() < 0.1
    with pytest.raises(SpecError, match="no piece"):
        PATH.interpolation(np.array([[0.0, 0.3, 5.0]]), SIDE)


def test_the_mesh_of_a_tunnel_faces_inward_and_has_its_area():
    mesh = scene_of(PATH, floor=(0.5, 0.4, 0.3)).mesh
    assert mesh.areas.sum() == pytest.approx(EDGE**2 * sum(AREA[piece] for piece in PATH.pieces), rel=5e-3)
    centre = mesh.triangles.mean(axis=1)
    piece, hit = PATH.located(centre / EDGE)
    for each in range(len(PATH.pieces)):
        rows = piece == each
        _, normal = PATH.place(each, hit.along[rows], hit.around[rows])
        assert np.sum(mesh.normals[rows] * normal, axis=1).min() > 0.99
    samples = tunnel_samples(PATH, SIDE)
    below = Tracer(scene_of(PATH)).intersect(samples.position + 0.1 * samples.normal, -samples.normal)
    assert np.all(below.front)
    assert 0.1 < below.distance.min() < below.distance.max() < 0.12


def test_a_tunnel_is_lit_as_a_traced_bake_of_its_mesh(pipes, tmp_path):
    tunnel, walls, floor = PATH, ((0.75, 0.7, 0.6), (0.7, 0.4, 0.3)), (0.4, 0.5, 0.6)
    scene = scene_of(tunnel, walls, floor)
    ds = bake(scene, "point", 8, 64, 128, 32, seed=0, out=tmp_path, supersampling=1)
    lightings = [lit(tunnel, piece)[1] for piece in range(len(tunnel.pieces))]
    wanted = prt.light(ds, lightings)
    points = tunnel_samples(tunnel, SIDE, walls, floor)
    direct = direct_irradiance(Tracer(scene), points, emitters(lightings)).reshape(len(lightings), 5, -1, 3)
    albedo = jnp.asarray(points.albedo.reshape(5, -1, 3), jnp.float32)
    operator = transfer(tunnel, pipes)
    spread = tunnel.interpolation(ds.points.position / EDGE, SIDE)
    light = [operator(jnp.asarray(each, jnp.float32), albedo, ds.transport.bounces) for each in direct]
    found = np.stack([spread @ np.asarray(each).reshape(-1, 3) for each in light])
    for mine, traced in zip(found, wanted.indirect, strict=True):
        assert relative_rmse(mine[None], traced[None]) < 0.06
    assert found.mean() == pytest.approx(wanted.indirect.mean(), rel=0.02)
    piece, _ = tunnel.located(ds.points.position / EDGE)
    for each in range(5):  # two corners away as well
        assert found[0][piece == each].mean() == pytest.approx(wanted.indirect[0][piece == each].mean(), rel=0.1)


@pytest.mark.parametrize("albedo", [0.5, 0.9])
def test_a_ring_absorbs_what_its_lamp_sends_out(pipes, albedo):
    """Σ (1 − ρ) (E + E_ind) = Σ E, by area, once all bounces are counted: nothing leaves a ring, and nothing is made in it."""
    direct, _ = lit(RING, 1)
    light = transfer(RING, pipes, depth=24)(direct, albedo, 120)
    assert (1.0 - albedo) * flux(RING, direct + light) == pytest.approx(flux(RING, direct), rel=0.03)


def test_a_white_tunnel_loses_what_leaves_through_its_ends(pipes):
    """A bounce gives no more light than there was, and the longer a tunnel, the more of it stays."""
    kept = []
    for length in (1, 4):
        tunnel = Tunnel(("straight",) * length)
        direct, _ = lit(tunnel, length // 2)
        operator, sent = transfer(tunnel, pipes, depth=12), flux(tunnel, direct)
        once, twice, often = (flux(tunnel, operator(direct, 1.0, bounces)) / sent for bounces in (1, 2, 30))
        assert twice - once < once < 1.001
        kept.append(often)
    assert kept[0] < kept[1] < 30.0
    alone = Tunnel(("straight",))
    direct, _ = lit(alone, 0)
    more = [flux(alone, transfer(alone, pipes)(direct, 1.0, bounces)) for bounces in (40, 80)]
    assert more[0] == pytest.approx(more[1], rel=1e-3)


def test_no_chain_of_pipes_amplifies(pipes):
    assert np.linalg.norm(np.asarray(pipes.onwards, float), 2, axis=(1, 2)).max() <= 1.0 + 1e-6
    mirror = np.asarray(pipes.mirror, float)
    np.testing.assert_allclose(mirror @ mirror, np.eye(len(mirror)), atol=1e-5)
    np.testing.assert_allclose(mirror, mirror.T, atol=1e-6)
    assert np.trace(mirror) < 0.8 * len(mirror)  # some lightfields are odd


def test_the_mirror_image_of_a_tunnel_has_the_mirror_image_of_its_light(pipes):
    other = {"straight": "straight", "left": "right", "right": "left"}
    mirrored = Tunnel(tuple(other[piece] for piece in PATH.pieces))
    direct, _ = lit(PATH, 1)
    order = np.asarray(transfer(PATH, pipes).turns)[MIRRORED]
    found = transfer(PATH, pipes)(direct, 0.7, 3)
    image = transfer(mirrored, pipes)(direct[:, order], 0.7, 3)
    assert np.linalg.norm(image[:, order] - found) < 0.01 * np.linalg.norm(found)


def test_a_tunnel_from_its_other_end_has_the_same_light(pipes):
    """Reversal takes a bend to the left to one to the right: what light does going back is not what it does going on."""
    other = {"straight": "straight", "left": "right", "right": "left"}
    reverse = Tunnel(tuple(other[piece] for piece in PATH.pieces[::-1]))
    direct, _ = lit(PATH, 3)
    order = np.asarray(transfer(PATH, pipes).turns)[BACK]
    found = np.asarray(transfer(PATH, pipes)(direct, 0.7, 3))
    back = np.asarray(transfer(reverse, pipes)(direct[::-1][:, order], 0.7, 3))[::-1][:, order]
    np.testing.assert_allclose(back, found, atol=1e-5 * found.max())


def test_what_is_prepared_is_the_tunnel(pipes):
    operator, random = transfer(PATH, pipes), np.random.default_rng(0)
    direct, albedo = random.random((2, 5, SIDE * SIDE, 3), np.float32)
    prepared = PreparedLevel(operator)
    wanted = np.swapaxes(np.asarray(operator(direct, albedo, 3)), 1, 2)[prepared.order]
    found = prepared(*(np.ascontiguousarray(np.swapaxes(each, 1, 2)[prepared.order]) for each in (direct, albedo)), 3)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * wanted.max())


def test_the_file_of_the_tunnel_is_the_scene():
    assert load_tunnel(LEVELS / "tunnel.toml").pieces == PIECES
    scene = load_scene("tunnel")
    piece, _ = Tunnel(PIECES).located(scene.mesh.triangles.mean(axis=1) / EDGE)
    assert np.bincount(piece).tolist() == [len(scene.mesh.faces) // 10] * 10
    assert unwrap(scene, 96).chart.max() == 9  # its own atlas, a chart for each piece


def test_random_tunnels_cross_themselves_nowhere_and_files_are_read(tmp_path):
    for seed in range(6):
        tunnel = random_tunnel(40, seed)
        assert len(set(tunnel.cells)) == 40
        assert not tunnel.ring
        assert tunnel == random_tunnel(40, seed)
    assert set(random_tunnel(40).pieces) == {"straight", "left", "right"}
    path = tmp_path / "tunnel.toml"
    path.write_text('tunnel = ["straight", "left"]\n', encoding="utf-8")
    assert load_tunnel(path) == Tunnel(("straight", "left"))
    for text, told in (
        ("tunnel = 3", "describes no tunnel"),
        ("blocks = [[0, 0]]", "describes no tunnel"),
        ('tunnel = ["up"]', "made of straight, left, right, not 'up'"),
        ("tunnel = []", "at least one piece"),
        ('tunnel = ["left", "left", "left", "left", "left"]', "piece 4 of a tunnel crosses piece 0"),
        ('tunnel = ["left"]\nend = 1', "unknown keys"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SpecError, match=told):
            load_tunnel(path)
    with pytest.raises(SpecError, match="at least one piece"):
        random_tunnel(0)


def test_a_dictionary_of_pipes_is_kept_and_other_sizes_are_refused(pipes, dictionary, tmp_path):
    again = PipeDictionary.load(pipes.save(tmp_path / "pipes.safetensors"))
    assert (again.bytes, again.side) == (pipes.bytes, SIDE)
    np.testing.assert_array_equal(again.mirror, pipes.mirror)
    with pytest.raises(FitError, match="no dictionary"):
        PipeDictionary.load(dictionary.save(tmp_path / "blocks.safetensors"))
    for sizes, told in (({"side": 15}, "even"), ({"side": 6}, "side"), ({"prior": 8}, "prior")):
        with pytest.raises(SpecError, match=told):
            build(**sizes)
