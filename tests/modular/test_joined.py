"""Levels in a scene: where blocks lie, and the one linear map that a level is against the level's own bounces."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.bake import bake
from data_gen.levels import EDGE, scene_of
from data_gen.scenes.maze import BLOCKS, SEED
from prt_bench.errors import FitError, SpecError
from prt_bench.metrics import relative_rmse
from prt_bench.modular.joined import joined
from prt_bench.modular.level import Level, maze, transfer
from prt_bench.modular.placed import Placed
from prt_bench.points import SurfacePoints

LEVELS = Path(__file__).parents[2] / "experiments" / "levels"
ROW = Level(((0, 0), (1, 0), (1, 1)))
PLACES = ((1.0, 3.0, 8.0), (0.5, 3.5), (-2.0, 0.0, 1.0))  # rooms of 2 m and 5 m by 2 m and 1 m, 3 m high
TOWER = Level(((0, 0, 0), (0, 1, 0), (1, 1, 0)))
STOREYS = ((1.0, 3.0, 8.0), (0.5, 3.5, 5.0), (-2.0, 0.0, 1.0))
CROSS = Level(((1, 1, 1), (0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2)))
THIRDS = ((0.0, 1.0, 3.0, 4.0),) * 3
RNG = np.random.default_rng(3)


def on_blocks(placed, side, albedo):
    """The samples of all blocks, where the placed level has them."""
    position, normal = placed.level.points(side)
    middle = np.array(placed.level.cells)[:, None]
    place = (
        np.stack([box.low for box in placed.boxes])[:, None]
        + (position - middle + 0.5) * np.stack([box.extent for box in placed.boxes])[:, None]
    )
    count = place.shape[0] * place.shape[1]
    every = np.broadcast_to(normal, place.shape).reshape(-1, 3)
    return SurfacePoints(
        place.reshape(-1, 3), every, albedo.reshape(-1, 3), np.zeros(count, int), np.full((count, 3), 1.0 / 3.0)
    )


@pytest.mark.parametrize(
    ("level", "places", "kept", "bounces"),
    [(ROW, PLACES, "dictionary", 1), (TOWER, STOREYS, "spatial", 4), (CROSS, THIRDS, "spatial", 3)],
)
def test_the_map_of_a_level_carries_the_light_that_its_blocks_do(level, places, kept, bounces, request):
    """Light in the span of the prior, at every sample; rooms are stretched, which changes neither side."""
    dictionary = request.getfixturevalue(kept)
    placed, side = Placed(level, *places), dictionary.side
    model = transfer(level, dictionary)
    count = len(level.cells)
    albedo = np.repeat(RNG.uniform(0.2, 0.8, (count, 6, 3)), side * side, axis=1)
    points = on_blocks(placed, side, albedo)
    area = sum(box.areas.sum() for box in placed.boxes) / len(points)
    likely = np.take_along_axis(
        np.asarray(dictionary.prior)[model.kind], np.asarray(model.turns)[model.pose][:, :, None], axis=1
    )
    radiosity = np.einsum("nsp,npc->nsc", likely, RNG.normal(size=(count, likely.shape[2], 3)))
    direct = radiosity / albedo
    wanted = np.asarray(model(jnp.asarray(direct), jnp.asarray(albedo), bounces))
    basis, block, matrix = joined(placed, dictionary, points, points, points, area, 200, 1e-12, bounces)
    coefficients = np.einsum("cqm,mc->qc", matrix, direct.reshape(-1, 3)).reshape(count, 200, 3)
    found = np.einsum("tk,tkc->tc", basis, coefficients[block]).reshape(wanted.shape)
    assert relative_rmse(found, wanted) < 1e-5
    if level is CROSS:
        return  # no light is at its middle, where no functions are to be orthonormal
    few, _, _ = joined(placed, dictionary, points, points, points, area, 12, 1e-12, bounces)
    assert few.shape == (len(points), 12)
    for n in range(3):
        np.testing.assert_allclose(few[block == n].T @ few[block == n], np.eye(12), atol=1e-9)


def test_points_on_a_wall_belong_to_the_block_they_face():
    placed = Placed(ROW, *PLACES)
    position = np.array([[3.0, 1.0, -1.0], [3.0, 1.0, -1.0], [7.9, 1.0, 0.5], [-5.0, 1.0, -1.0]])
    normal = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    points = SurfacePoints(position, normal, np.ones((4, 3)), np.zeros(4, int), np.full((4, 3), 1.0 / 3.0))
    assert placed.owner(points).tolist() == [0, 1, 2, 0]
    points = replace(points, position=position - np.array([2.5, 0.0, -1.5]))
    with pytest.raises(FitError, match=r"lies in cell \[0, 0, 1\], where the level has no block"):
        placed.owner(points)
    between = replace(
        points[:2], position=np.tile((2.0, 3.5, -1.0), (2, 1)), normal=np.array([[0, 1.0, 0], [0, -1.0, 0]])
    )
    assert Placed(TOWER, *STOREYS).owner(between).tolist() == [1, 0]


def test_the_file_of_the_maze_is_the_maze():
    placed, level = Placed.load(LEVELS / "maze.toml"), maze(BLOCKS, SEED)
    for box, cell in zip(placed.boxes, level.cells, strict=True):
        np.testing.assert_allclose(box.low + 0.5 * box.extent, EDGE * np.array(cell))
    assert placed.level.open == level.open
    assert np.all(placed.owner(on_blocks(placed, 4, np.ones((BLOCKS, 96, 3)))) == np.repeat(np.arange(BLOCKS), 96))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("blocks = [[0, 0]]", "add x, y, z in metres"),
        ("blocks = [[0, 0]]\nx = [0, 1]\ny = [1, 0]\nz = [0, 1]", "`y` of a level must be two or more rising places"),
        ("blocks = [[1, 0]]\nx = [0, 1]\ny = [0, 1]\nz = [0, 1]", r"block \[1, 0, 0\] of a level lies beyond"),
        ("blocks = [[0, 2, 0]]\nx = [0, 1]\ny = [0, 1, 2]\nz = [0, 1]", "2 layers and 1 rows"),
        ("blocks = [[0, 0]]\nx = [0, 'a']\ny = [0, 1]\nz = [0, 1]", "lists of numbers in metres"),
        ("blocks = [[0, 0]]\nlines = 3", "unknown keys"),
    ],
)  # fmt: skip
def test_files_that_place_no_level_are_refused(tmp_path, text, told):
    path = tmp_path / "level.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError, match=told):
        Placed.load(path)


def test_a_level_is_lit_by_a_method_that_has_never_seen_it(spatial, tmp_path, monkeypatch):
    """A wall between two rooms, one of which has a gallery: a box about all spreads light through the wall, blocks do not."""

    def standard(dimension=2, **_):
        assert dimension == 3
        return spatial

    monkeypatch.setattr(import_module("prt_bench.methods.modular"), "standard", standard)
    level = Level(((0, 0), (1, 0), (1, 1, 0)), frozenset({frozenset({(0, 0), (1, 0)})}))
    ds = bake(scene_of(level, ((0.6, 0.5, 0.4),) * 6), "point", 24, 32, 64, 192, seed=0, out=tmp_path / "data")
    path = tmp_path / "level-3.toml"
    path.write_text(
        "blocks = [[0, 0], [1, 0], [1, 1, 0]]\nwalls = [[[0, 0], [1, 0]]]\n"
        "x = [-1.5, 1.5, 4.5]\ny = [-1.5, 1.5, 4.5]\nz = [-1.5, 1.5]\n",
        encoding="utf-8",
    )
    test = ds.split("test")

    def error(**settings):
        model = prt.method("modular", basis=16, **settings).fit(ds.split("train"))
        return relative_rmse(np.asarray(model.predict(test)), test.indirect)

    assert error(level=str(tmp_path)) < 0.3
    assert error() > 0.4
