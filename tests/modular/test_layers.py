"""Levels of several layers: by furnaces, by rays in their own mesh, and by rotations, which must change nothing."""

from itertools import product

import jax.numpy as jnp
import numpy as np
import pytest

from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.tracer import Tracer
from prt_bench.errors import SpecError
from prt_bench.modular.cube import cosine_rays
from prt_bench.modular.dictionary import DOORS, KINDS, Dictionary, build
from prt_bench.modular.level import Level, load_level, maze, transfer
from prt_bench.modular.lightfield import Grid, propagation, rolling
from prt_bench.modular.passages import Passages
from prt_bench.modular.rotations import FACE, INVERSE, PRODUCT, ROTATIONS, turns

from .conftest import SIDE
from .test_levels import lit, solid

RAYS = 16  # of a sample, squared
HALL = Level(tuple(product(range(3), repeat=3)))  # one block has no face, six have one
CELLS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 0), (1, 2, 0))
STAIRS = Level(CELLS, frozenset({frozenset(((0, 0, 0), (0, 1, 0)))}))


def turned(level, rotation):
    """The level after a rotation about its first cell."""

    def cell(given):
        return tuple(int(at) for at in ROTATIONS[rotation] @ given)

    return Level(tuple(map(cell, level.cells)), frozenset(frozenset(map(cell, wall)) for wall in level.walls))


def bounced(level, function):
    """One bounce of light on the first block alone: rays from all samples of the level's own mesh."""
    scene, points = scene_of(level), block_samples(level, SIDE)
    there = np.flatnonzero(solid(level))
    rays = cosine_rays(points.normal[there], RAYS).reshape(-1, 3)
    origin = np.repeat(points.position[there], RAYS**2, axis=0) + 1e-4 * rays
    hits = Tracer(scene).intersect(origin, rays)
    place, normal = (origin + hits.distance[:, None] * rays) / EDGE, scene.mesh.normals[hits.face]
    seen = (level.located(place - 1e-3 * rays, normal)[0] == 0) & hits.front
    found = np.zeros(len(points))
    found[there] = (
        (np.asarray(function(jnp.asarray(place), jnp.asarray(normal))) * seen).reshape(-1, RAYS**2).mean(axis=1)
    )
    return found.reshape(len(level.cells), -1)


@pytest.mark.parametrize(
    "level",
    [
        Level(((0, 0, 0), (0, 1, 0), (1, 1, 0))),
        Level(((0, 0, 0), (1, 0, 0), (1, -1, 0))),
        Level(tuple(product(range(2), repeat=3))),
    ],
    ids=["up", "down", "hall"],
)
def test_light_goes_up_and_down_as_rays_do(spatial, level):
    direct, function = lit(level, (0.1, 0.2, -0.1))
    direct[1:] = 0.0
    wanted = bounced(level, function)
    found = np.asarray(transfer(level, spatial)(jnp.asarray(direct[..., None], jnp.float32), 1.0))[..., 0]
    for block in range(len(level.cells)):
        assert np.linalg.norm(found[block] - wanted[block]) < 0.2 * np.linalg.norm(wanted[block]), block
        assert found[block].sum() == pytest.approx(wanted[block].sum(), rel=0.1), block
    assert np.linalg.norm(found - wanted) < 0.08 * np.linalg.norm(wanted)


@pytest.mark.parametrize("level", [HALL, maze(12, seed=3, layers=3)], ids=["hall", "maze"])
def test_a_furnace_is_as_bright_everywhere(spatial, level):
    """Even light on white surfaces comes back as it is; with albedo ρ, 1 − ρ of all light is absorbed at a time."""
    assert level.dimension == 3
    model = transfer(level, spatial, depth=10, tolerance=0.0)
    there = np.asarray(model.solid)[:, :, None]
    once = np.asarray(model(jnp.asarray(there), 1.0))
    np.testing.assert_allclose(once, there, atol=0.1)
    assert once.sum() == pytest.approx(there.sum(), rel=0.015)
    light = np.asarray(model(jnp.asarray(there), 0.7, 20), float)
    assert 0.3 * (there.sum() + light.sum()) == pytest.approx(there.sum(), rel=0.03)


def test_rolls_are_rotations_of_what_is_kept_and_nothing_amplifies(spatial):
    roll, straight = np.asarray(spatial.roll[0], float), np.asarray(spatial.onwards[0], float)
    np.testing.assert_allclose(roll @ roll.T, np.eye(len(roll)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.matrix_power(roll, 4), np.eye(len(roll)), atol=1e-6)
    np.testing.assert_allclose(straight @ roll, roll @ straight, atol=1e-5)
    passages = Passages(spatial)
    for along in range(6):
        exits = [passages.onwards(along, exit_) for exit_ in range(6) if exit_ != along ^ 1]
        assert np.linalg.norm(np.concatenate(exits), 2) <= 1.0  # of all five together


def test_right_is_left_between_rolls():
    grid = Grid(4, 8)
    roll = rolling(grid)
    upside_down = roll[roll]
    assert not np.array_equal(upside_down, np.arange(grid.size))
    np.testing.assert_array_equal(upside_down[upside_down], np.arange(grid.size))
    left, right, straight = (propagation(way, grid).toarray() for way in ("left", "right", "straight"))
    away = np.linalg.norm(left[upside_down][:, upside_down] - right)
    assert away < 0.06 * np.linalg.norm(right)  # rays through edges belong to either side
    assert np.linalg.norm(left - right) > 0.5 * np.linalg.norm(right)
    np.testing.assert_allclose(straight[roll][:, roll], straight, atol=1e-12)


def symmetric(seed=0):
    """A dictionary of any numbers that knows no pose from another: means over the rotations that leave an entry as it is."""
    random, quarter = np.random.default_rng(seed), np.roll(np.eye(4), 1, axis=0)
    order, n, functions, fields, arriving = turns(SIDE), 6 * SIDE**2, 5, 8, 12
    rolls = [np.linalg.matrix_power(np.kron(quarter, np.eye(size)), m) for size in (2, 3) for m in range(4)]
    basis, read = random.random((len(KINDS), n, functions)), random.random((len(KINDS), functions, n))
    leave = dict(zip(DOORS, random.random((len(DOORS), fields, functions)), strict=True))
    kept = [[r for r in range(24) if set(FACE[r, list(faces)]) == set(faces)] for faces in KINDS]
    basis = [np.mean([one[order[r]] for r in same], axis=0) for one, same in zip(basis, kept, strict=True)]
    read = [np.mean([one[:, order[r]] for r in same], axis=0) for one, same in zip(read, kept, strict=True)]
    means = []
    for kind, face in DOORS:
        from_ = [(r, FACE[INVERSE[r], face]) for r in kept[kind]]
        frames = [PRODUCT[INVERSE[face], PRODUCT[r, other]] // 6 for r, other in from_]
        means.append(np.mean([rolls[m] @ leave[kind, f] for m, (_, f) in zip(frames, from_, strict=True)], axis=0))
    straight, left = random.random((2, fields, fields)) / fields
    straight = np.mean([rolls[m] @ straight @ rolls[-m % 4] for m in range(4)], axis=0)
    arrive, light = random.random((arriving, fields)), random.random((n, arriving))
    arrive = np.mean([rolls[4 + m] @ arrive @ rolls[-m % 4] for m in range(4)], axis=0)
    light = np.mean([light[order[6 * m]] @ rolls[4 + -m % 4] for m in range(4)], axis=0)
    parts = basis, read, basis, means, (straight, left), rolls[1:2], arrive, light
    return Dictionary(*(jnp.asarray(np.array(part), jnp.float32) for part in parts))


def test_a_rotated_level_has_the_rotated_light():
    """Exactly so if the dictionary favours no direction; poses, doors, frames and rolls are then all that is left."""
    dictionary, order = symmetric(), turns(SIDE)
    for level in (STAIRS, HALL):
        radiosity = np.random.default_rng(1).random((len(level.cells), 6 * SIDE**2, 2), np.float32)
        wanted = np.asarray(transfer(level, dictionary, 4, 0.0)(radiosity, 1.0))
        for rotation in range(24) if level is STAIRS else (7, 14, 21):
            model = transfer(turned(level, rotation), dictionary, 4, 0.0)
            found = np.asarray(model(radiosity[:, order[rotation]], 1.0))
            np.testing.assert_allclose(found, wanted[:, order[rotation]], atol=1e-5 * wanted.max())


def test_the_dictionary_favours_no_direction_much(spatial):
    order, direct = turns(SIDE), lit(STAIRS, (0.1, 0.2, -0.1))[0][..., None]
    direct[1:] = 0.0
    wanted = np.asarray(transfer(STAIRS, spatial)(jnp.asarray(direct, jnp.float32), 0.7, 3))
    for rotation in (2, 9, 17):
        given = jnp.asarray(direct[:, order[rotation]], jnp.float32)
        found = np.asarray(transfer(turned(STAIRS, rotation), spatial)(given, 0.7, 3))
        assert np.linalg.norm(found - wanted[:, order[rotation]]) < 0.05 * np.linalg.norm(wanted)


def test_flat_levels_are_lit_alike_by_either_dictionary(dictionary, spatial):
    level = maze(8, seed=2)
    assert level.dimension == 2
    direct = lit(level, (0.1, 0.2, -0.1))[0][..., None]
    direct[1:] = 0.0
    flat, found = (
        np.asarray(transfer(level, each)(jnp.asarray(direct, jnp.float32), 0.7, 3)) for each in (dictionary, spatial)
    )
    assert np.linalg.norm(found - flat) < 0.03 * np.linalg.norm(flat)
    assert found.sum() == pytest.approx(flat.sum(), rel=0.01)


def test_levels_of_layers_are_read_and_need_their_dictionary(dictionary, tmp_path):
    path = tmp_path / "level.toml"
    path.write_text("blocks = [[0, 0], [0, 1, 0], [1, 0]]\nwalls = [[[0, 0], [1, 0, 0]]]\n", encoding="utf-8")
    level = load_level(path)
    assert level.cells == ((0, 0, 0), (0, 1, 0), (1, 0, 0))
    assert level.open == [{2: 1}, {3: 0}, {}]
    with pytest.raises(SpecError, match="up or down"):
        transfer(level, dictionary)
    with pytest.raises(SpecError, match="dimension"):
        build(dimension=4)
    with pytest.raises(SpecError, match="column, layer, row"):
        Level(((0,),))
    with pytest.raises(SpecError, match="layer"):
        maze(5, layers=0)
    found = {cell[1] for cell in maze(40, seed=1, layers=2).cells}
    assert found == {0, 1}
    flat = maze(20, seed=4)
    assert {cell[1] for cell in flat.cells} == {0}


def test_the_mesh_of_a_tower_is_closed_and_faces_inward():
    level = maze(9, seed=2, loops=1.0, layers=3)  # no wall takes room
    corners = scene_of(level).mesh.triangles
    volume = -np.einsum("fc,fc->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert level.dimension == 3
    assert volume == pytest.approx(9 * EDGE**3)
