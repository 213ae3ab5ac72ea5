"""Levels against light traced in boxes of several blocks, and by what must not depend on how a level is written."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.tracer import Tracer
from prt_bench.emitters import irradiance
from prt_bench.errors import FitError, SpecError
from prt_bench.lights import Lighting, SphereLight, emitters
from prt_bench.modular.cube import cosine_rays, one_bounce
from prt_bench.modular.dictionary import KINDS, Dictionary, build, entry_of
from prt_bench.modular.level import Level, load_level, maze, transfer
from prt_bench.modular.lightfield import EXITS, contracted, emission, propagation, response
from prt_bench.modular.rotations import FACE

from .conftest import GRID, SIDE


def lit(level, place):
    """Irradiance of a sphere light at a level's samples, nothing in its way, and a function for any other points."""
    light = jax.tree.map(lambda leaf: leaf[0], emitters([Lighting([SphereLight(jnp.array(place), 0.05, jnp.ones(3))])]))
    function = jax.jit(lambda position, normal: irradiance(light, position, normal)[:, 0])
    position, normal = level.points(SIDE)
    direct = np.stack([np.asarray(function(jnp.asarray(block), jnp.asarray(normal))) for block in position])
    return direct * solid(level), function


def solid(level):
    found = np.zeros((len(level.cells), 6 * SIDE**2))
    for block, face in level.surfaces():
        found[block, face * SIDE**2 : (face + 1) * SIDE**2] = 1.0
    return found


def traced(level, function):
    """One bounce in a row of blocks, which is a box: rays from every sample, and light evaluated where they end."""
    length = len(level.cells)
    half, middle = np.array([length, 1.0, 1.0]) / 2.0, np.array([(length - 1) / 2.0, 0.0, 0.0])
    position, normal = level.points(SIDE)
    found = []
    for block in position:
        rays = cosine_rays(normal, 24)
        origin, direction = np.repeat(block - middle, rays.shape[1], axis=0), rays.reshape(-1, 3)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = np.where(direction == 0, np.inf, (np.copysign(half, direction) - origin) / direction)
        axis, rows = np.argmin(away, axis=1), np.arange(len(origin))
        hit = origin + away[rows, axis, None] * direction + middle
        facing = np.zeros_like(hit)
        facing[rows, axis] = -np.sign(direction[rows, axis])
        found.append(np.asarray(function(jnp.asarray(hit), jnp.asarray(facing))).reshape(len(block), -1).mean(axis=1))
    return np.stack(found) * solid(level)


@pytest.mark.parametrize(("length", "place"), [(1, (0.1, 0.2, -0.1)), (2, (0.0, 0.1, 0.1)), (3, (0.1, -0.1, 0.2))])
def test_a_row_of_blocks_is_lit_like_the_box_it_is(dictionary, length, place):
    level = Level(tuple((i, 0) for i in range(length)))
    direct, function = lit(level, place)
    wanted = traced(level, function)
    found = np.asarray(transfer(level, dictionary)(jnp.asarray(direct[..., None], jnp.float32), 1.0))[..., 0]
    for block in range(length):
        assert np.linalg.norm(found[block] - wanted[block]) < 0.12 * np.linalg.norm(wanted[block]), block
        assert found[block].sum() == pytest.approx(wanted[block].sum(), rel=0.05), block


def test_turning_a_level_turns_its_light(dictionary):
    level = Level(((0, 0), (1, 0), (1, 1)))
    turned = Level(tuple((row, -column) for column, _, row in level.cells))
    results = [
        np.asarray(transfer(each, dictionary)(jnp.asarray(lit(each, place)[0][..., None], jnp.float32), 0.7, 3))
        for each, place in ((level, (0.1, 0.2, 0.3)), (turned, (0.3, 0.2, -0.1)))
    ]
    one, other = (np.sort(each.reshape(len(each), -1), axis=1) for each in results)
    np.testing.assert_allclose(one, other, atol=0.02 * one.max())


def test_walls_keep_light_out_and_light_goes_round_corners(dictionary):
    cells = ((0, 0), (1, 0), (1, 1), (0, 1))
    closed = Level(cells, frozenset({frozenset(((0, 0), (0, 1))), frozenset(((0, 1), (1, 1)))}))
    around = Level(cells, frozenset({frozenset(((0, 0), (0, 1)))}))
    found = []
    for level in (closed, around):
        direct = lit(level, (0.0, 0.1, 0.0))[0]
        direct[1:] = 0.0
        found.append(np.asarray(transfer(level, dictionary)(jnp.asarray(direct[..., None], jnp.float32), 0.7, 4)))
    assert not np.any(found[0][3])
    assert found[1][3].mean() > 0
    assert found[1][3].mean() < found[1][2].mean() < found[1][1].mean()


@pytest.mark.parametrize("blocks", [1, 3, 6])
def test_a_closed_maze_absorbs_what_its_lights_send_out(dictionary, blocks):
    """Σ (1 − ρ) (E + E_ind) = Σ E once all bounces are counted."""
    level, albedo = maze(blocks, seed=2), 0.6
    direct = lit(level, (0.0, 0.0, 0.0))[0]
    light = transfer(level, dictionary, depth=16)(jnp.asarray(direct[..., None], jnp.float32), albedo, 40)
    absorbed = (1.0 - albedo) * (direct.sum() + float(np.asarray(light, float).sum()))
    assert absorbed == pytest.approx(direct.sum(), rel=0.03)


def test_no_chain_of_interfaces_amplifies(dictionary):
    onwards = np.asarray(dictionary.onwards, float)
    assert np.linalg.norm(onwards, 2, axis=(1, 2)).max() <= 1.0 + 1e-6
    grown = np.diag([1.3, 0.9, 0.5])
    np.testing.assert_allclose(contracted(grown), np.diag([1.0, 0.9, 0.5]), atol=1e-12)


def test_interfaces_pass_even_light_as_form_factors_say():
    even = np.ones(GRID.size)
    face = np.repeat(np.arange(6), SIDE**2)
    np.testing.assert_allclose(emission(SIDE, GRID) @ np.ones(6 * SIDE**2), 1.0 / np.pi, rtol=1e-12)
    received = response(SIDE, GRID) @ even
    seen = np.pi * one_bounce(SIDE)[:, face == 1].sum(axis=1)
    assert received[face != 1].mean() == pytest.approx(seen[face != 1].mean(), rel=0.01)
    for way in EXITS:
        share = (propagation(way, GRID) @ even).mean()
        assert share == pytest.approx(0.19982 if way == "straight" else 0.20004, abs=2e-3)


def test_every_set_of_faces_but_all_has_an_entry():
    for mask in range(63):
        missing = {face for face in range(6) if mask >> face & 1}
        kind, pose = entry_of(missing)
        assert set(FACE[pose, list(KINDS[kind])]) == missing
        if not missing & {2, 3}:
            assert kind < 6
            assert pose in (0, 1, 4, 5)  # turned about +y
    with pytest.raises(SpecError):
        entry_of({7})


def test_light_at_points_is_found_in_their_block():
    level = Level(((0, 0), (1, 0), (1, 1)))
    position, normal = level.points(SIDE)
    kept = solid(level).ravel() > 0
    flat, facing = position.reshape(-1, 3)[kept], np.tile(normal, (3, 1))[kept]
    table = level.interpolation(flat, facing, SIDE)
    np.testing.assert_allclose(table @ np.arange(kept.size), np.flatnonzero(kept), atol=1e-9)
    with pytest.raises(SpecError, match="no block"):
        level.interpolation(np.array([[5.0, -0.5, 0.0]]), np.array([[0.0, 1.0, 0.0]]), SIDE)


def test_the_mesh_of_a_level_is_closed_and_faces_inward():
    level = maze(5, seed=1)
    scene = scene_of(level)
    corners = scene.mesh.triangles
    volume = -np.einsum("fc,fc->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(5 * EDGE**3)


def test_walls_between_blocks_show_their_fronts_to_both():
    """Faces of two blocks in one plane would hide each other: half of the light on such a wall was lost."""
    cells = ((0, 0), (1, 0), (1, 1), (0, 1))
    level = Level(cells, frozenset({frozenset(((0, 0), (0, 1))), frozenset(((0, 1), (1, 1)))}))
    direction = np.random.default_rng(0).normal(size=(2000, 3))
    middle = EDGE * np.repeat([(0.2, 0.1, 0.3), (0.2, 0.1, 0.8)], 1000, axis=0)
    hits = Tracer(scene_of(level)).intersect(middle, direction)
    assert np.mean(hits.front) > 0.998  # what is left looks into the cut of a wall
    samples = block_samples(level, 4)
    below = Tracer(scene_of(level)).intersect(samples.position + 0.1 * samples.normal, -samples.normal)
    there = solid_at(level, 4)
    np.testing.assert_allclose(below.distance[there], 0.1, atol=1e-5)


def solid_at(level, side):
    """Which samples of blocks lie on faces that are there."""
    found = np.zeros((len(level.cells), 6), bool)
    found[tuple(np.transpose(level.surfaces()))] = True
    return np.repeat(found.ravel(), side**2)


def test_a_dictionary_is_kept_and_other_files_are_refused(dictionary, tmp_path):
    path = dictionary.save(tmp_path / "blocks.safetensors")
    again = Dictionary.load(path)
    assert again.bytes == dictionary.bytes
    np.testing.assert_array_equal(again.onwards, dictionary.onwards)
    path.write_bytes(b"no dictionary")
    with pytest.raises(FitError, match="no dictionary"):
        Dictionary.load(path)
    with pytest.raises(SpecError, match="side"):
        build(side=2)


def test_levels_are_read_and_wrong_ones_refused(tmp_path, dictionary):
    path = tmp_path / "level.toml"
    path.write_text("blocks = [[0, 0], [1, 0]]\nwalls = [[[0, 0], [1, 0]]]\n", encoding="utf-8")
    level = load_level(path)
    assert level.open == [{}, {}]
    for text in (
        "blocks = 3",
        "blocks = [[0, 0], [0, 0]]",
        "blocks = [[0, 0]]\nwalls = [[[0, 0], [1, 0]]]",
        "colour = 1",
        "[",
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SpecError):
            load_level(path)
    assert maze(30, seed=4) == maze(30, seed=4)
    assert len(maze(200).cells) == 200
    for wrong in (lambda: maze(0), lambda: transfer(level, dictionary, depth=0)):
        with pytest.raises(SpecError):
            wrong()
