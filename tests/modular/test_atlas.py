"""The padded image of a level: no seam where surfaces go on, and the last texel where they end."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from data_gen.levels import EDGE, scene_of
from prt_bench.errors import SpecError
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.level import Level, maze
from prt_bench.scene import Mesh

SIDE = 4
SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
FLOOR, BACK = 3, 5
UP, FORTH = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


def lookup(image, uv):
    """Bilinear, as a texture unit does it."""
    at = uv * len(image) - 0.5
    low = np.floor(at).astype(int)
    (x, y), (column, row) = (at - low).T, low.T
    rows = [(1 - x) * image[row + j, column] + x * image[row + j, column + 1] for j in (0, 1)]
    return (1 - y) * rows[0] + y * rows[1]


def lit(level, seed=0):
    """An atlas, any light at the level's samples, and its image."""
    atlas = LevelAtlas(level, SIDE)
    light = np.random.default_rng(seed).random(len(level.cells) * 6 * SIDE**2)
    image = np.where(atlas.source < 0, np.nan, light[atlas.source]).reshape(atlas.resolution, -1)
    return atlas, light, image


def joined(level, light, face, axes):
    """Interpolation over all samples of one face of all blocks, by where they are."""
    position, _ = level.points(SIDE)
    rows = slice(face * SIDE**2, (face + 1) * SIDE**2)
    place = position[:, rows][..., axes].reshape(-1, len(axes))
    values = light.reshape(len(position), -1)[:, rows].ravel()
    lines = [np.unique(np.round(place[:, axis], 9)) for axis in range(len(axes))]
    table = np.empty([len(line) for line in lines])
    table[tuple(np.searchsorted(line, place[:, axis] - 1e-6) for axis, line in enumerate(lines))] = values
    return RegularGridInterpolator(lines, table)


@pytest.mark.parametrize(
    ("cells", "face", "axes", "normal"),
    [(SQUARE, FLOOR, [0, 2], UP), (((0, 0), (1, 0)), BACK, [0, 1], FORTH)],
)
def test_a_lookup_is_that_of_the_joined_surface_from_both_sides(cells, face, axes, normal):
    level = Level(cells)
    atlas, light, image = lit(level)
    wanted = joined(level, light, face, axes)
    rng = np.random.default_rng(1)
    places = np.full((500, 3), -0.5)
    low, high = (-0.5, 1.5) if face == FLOOR else (-0.5, 0.5)
    places[:, 0] = rng.uniform(0.2, 0.8, 500)
    places[:, axes[1]] = rng.uniform(low + 0.5 / SIDE, high - 0.5 / SIDE, 500)
    block, faces = level.located(places, np.tile(normal, (500, 1)))
    assert set(faces) == {face}
    found = lookup(image, atlas.uv(places, block, faces))
    np.testing.assert_allclose(found, wanted(places[:, axes]), atol=1e-12)
    places[:, 0] = 0.5  # the seam itself, shown by the tile of either block
    across = [
        block,
        np.array([level.cells.index((1 - column, 0, row)) for column, _, row in np.array(level.cells)[block]]),
    ]
    left, right = (lookup(image, atlas.uv(places, at, faces)) for at in across)
    np.testing.assert_allclose(left, right, atol=1e-12)
    np.testing.assert_allclose(left, wanted(places[:, axes]), atol=1e-12)


def test_behind_a_wall_and_at_corners_the_last_texel_stands():
    level = Level(SQUARE, frozenset({frozenset(((0, 0), (1, 0)))}))
    atlas, light, image = lit(level)
    table = light.reshape(4, 6, SIDE, SIDE)  # rows of the floor are along x, columns along z
    rows = np.arange(1, SIDE - 1)
    for edge, block, at in ((0.5, 0, SIDE - 1), (0.5, 1, 0), (-0.5, 0, 0)):
        place = np.stack([np.full(2, edge), np.full(2, -0.5), (rows + 0.5) / SIDE - 0.5], axis=1)
        found = lookup(image, atlas.uv(place, np.full(2, block), np.full(2, FLOOR)))
        np.testing.assert_allclose(found, table[block, FLOOR, at, rows], atol=1e-12)


@pytest.mark.parametrize(
    "level", [maze(25, seed=3, loops=0.4), maze(25, seed=4, loops=0.4, layers=3)], ids=["flat", "tall"]
)
def test_tiles_of_a_maze_agree_along_all_their_seams(level):
    """But for the foot of a wall's end, where a texel of the border would have to follow both sides of the wall."""
    atlas, _, image = lit(level)
    tiles, seams = set(level.surfaces()), np.zeros(3, int)
    for block, doors in enumerate(level.open):
        for beyond, other in doors.items():
            axis = beyond // 2
            for face in range(6):
                if beyond % 2 or face // 2 == axis or not {(block, face), (other, face)} <= tiles:
                    continue
                seams[axis] += 1
                place = np.tile(np.array(level.cells[block], float), (7, 1))
                place[:, axis] += 0.5
                place[:, face // 2] += 0.5 - face % 2
                place[:, 3 - axis - face // 2] += np.linspace(-0.5 + 0.5 / SIDE, 0.5 - 0.5 / SIDE, 7)
                one, two = (lookup(image, atlas.uv(place, np.full(7, at), np.full(7, face))) for at in (block, other))
                np.testing.assert_allclose(one, two, atol=1e-12)
    assert seams[[0, 2]].min() > 10
    assert (seams[1] > 10) == (level.dimension == 3)
    assert len(tiles) * (SIDE + 2) ** 2 == np.sum(atlas.source >= 0)


def test_every_texel_shows_a_face_that_is_there():
    level = maze(12, seed=5)
    there = {block * 6 + face for block, face in level.surfaces()}
    source = LevelAtlas(level, SIDE).source
    assert set(np.unique(source[source >= 0] // SIDE**2)) == there


def test_the_mesh_of_a_level_lies_in_its_tiles():
    level = maze(6, seed=2, layers=2)
    atlas, scene = LevelAtlas(level, SIDE), scene_of(level)
    lightmap = atlas.lightmap(scene.mesh, EDGE)
    texels = lightmap.corner_uv * atlas.resolution
    np.testing.assert_allclose(np.ptp(texels, axis=1), SIDE, atol=1e-9)  # each triangle is half of its tile
    assert len(np.unique(lightmap.chart)) == len(level.surfaces())
    wide = np.array([(-0.4, -0.5, -0.4), (0.4, -0.5, 1.4), (1.4, -0.5, -0.4)])
    with pytest.raises(SpecError, match="beyond its block"):
        LevelAtlas(Level(SQUARE), SIDE).lightmap(Mesh(wide, np.array([[0, 1, 2]]), np.zeros(1, int)), 1.0)
    gone = np.array([next(iter(level.open[0]))])
    with pytest.raises(SpecError, match="missing"):
        atlas.uv(np.zeros((1, 3)), np.array([0]), gone)
