"""Levels: blocks on a grid, which are open to their neighbours unless a wall stands between, and the light in them.

A flat level is one of a single layer. Connectivity alone decides how light passes from block to block: breadth first from every
block, its lightfields are carried through interfaces to a depth, and summed for each block and interface it enters
(`carried`): T, a sparse matrix of blocks.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import csr_array

from prt_bench.errors import SpecError
from prt_bench.modular.carried import carried
from prt_bench.modular.cube import FACES, Met, bilinear, sample_points
from prt_bench.modular.dictionary import Dictionary, Operators, entry_of
from prt_bench.modular.passages import Passages
from prt_bench.modular.rotations import INVERSE, turns

Cell = tuple[int, ...]
STEPS: tuple[Cell, ...] = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
"""Neighbours beyond each face, in columns, layers and rows."""
_MAZE = (0, 5, 1, 4), (0, 5, 1, 4, 2, 3)
"""Faces that a maze grows through, of one layer and of more; walls are looked for beyond the first of each opposite pair."""


@dataclass(frozen=True)
class Level:
    """Cells (column, layer, row) that hold a block, and pairs of neighbours with a wall between them.

    A pair (column, row) is a cell of layer 0. Raises `SpecError` for other cells, no cell, a cell twice, and walls that are not
    between neighbouring blocks.
    """

    cells: tuple[Cell, ...]
    walls: frozenset[frozenset[Cell]] = frozenset()

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", tuple(map(_cell, self.cells)))
        object.__setattr__(self, "walls", frozenset(frozenset(map(_cell, wall)) for wall in self.walls))
        if not self.cells or len(set(self.cells)) < len(self.cells):
            raise SpecError("a level needs at least one block, and each cell once")
        for wall in self.walls:
            one, *other = sorted(wall)
            if not other or set(wall) - set(self.cells) or tuple(np.subtract(other[0], one)) not in STEPS:
                raise SpecError(f"the wall {sorted(wall)} of a level is not between two neighbouring blocks")

    @property
    def open(self) -> list[dict[int, int]]:
        """For every block the faces that are missing, and the block behind each."""
        index = {cell: at for at, cell in enumerate(self.cells)}
        found = []
        for cell in self.cells:
            beyond = {face: _beyond(cell, face) for face in range(FACES)}
            found.append(
                {
                    face: index[other]
                    for face, other in beyond.items()
                    if other in index and frozenset((cell, other)) not in self.walls
                }
            )
        return found

    @property
    def dimension(self) -> int:
        """Of the dictionary that it needs: 3 where light goes from layer to layer, else 2."""
        return 3 if any({2, 3} & set(faces) for faces in self.open) else 2

    def points(self, side: int) -> tuple[Float[np.ndarray, "N n 3"], Float[np.ndarray, "n 3"]]:
        """Positions of every block's samples, in edges of a block, and their normals. A block's cell is its centre."""
        position, normal = sample_points(side)
        return np.array(self.cells, float)[:, None] + position, normal

    def interpolation(
        self, position: Float[np.ndarray, "P 3"], normal: Float[np.ndarray, "P 3"], side: int
    ) -> csr_array:
        """[P, N n]: light at points on the level's faces from light at all blocks' samples; lengths in edges of a block.

        Raises `SpecError` for a point that lies in no block.
        """
        block, face = self.located(position, normal)
        columns, weights = bilinear(self.on_face(position, block, face), side)
        columns = columns + (block * FACES * side * side)[:, None]
        shape = (len(block), len(self.cells) * FACES * side * side)
        return csr_array((weights.ravel(), columns.ravel(), 4 * np.arange(len(block) + 1)), shape=shape)

    def located(
        self, position: Float[np.ndarray, "P 3"], normal: Float[np.ndarray, "P 3"]
    ) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
        """Block and face that surfaces at these points, in edges of a block, belong to.

        Raises `SpecError` for a point that lies in no block.
        """
        index = {cell: at for at, cell in enumerate(self.cells)}
        within = position + 1e-3 * normal
        cells = [tuple(cell) for cell in np.round(within).astype(int).tolist()]
        lost = next((cell for cell in cells if cell not in index), None)
        if lost is not None:
            raise SpecError(f"a point lies in cell {lost}, where the level has no block")
        axis, rows = np.argmax(np.abs(normal), axis=1), np.arange(len(position))
        return np.array([index[cell] for cell in cells], int), 2 * axis + (normal[rows, axis] > 0)

    def on_face(
        self, position: Float[np.ndarray, "P 3"], block: Int[np.ndarray, " P"], face: Int[np.ndarray, " P"]
    ) -> Met:
        """Where points lie on faces of these blocks; beyond a face's edge, the nearest place on it."""
        local = np.clip(position - np.array(self.cells, float)[block] + 0.5, 0.0, 1.0)
        axis, points = face // 2, np.arange(len(block))
        return Met(face, local[points, (axis + 1) % 3], local[points, (axis + 2) % 3])

    def surfaces(self) -> list[tuple[int, int]]:
        """(block, face) of all faces that are there."""
        return [(block, face) for block, gone in enumerate(self.open) for face in range(FACES) if face not in gone]


def _cell(given: Cell) -> Cell:
    if len(given) not in (2, 3):
        raise SpecError(f"a cell of a level is (column, layer, row), or (column, row) on layer 0, not {list(given)}")
    return given if len(given) == 3 else (given[0], 0, given[1])


def _beyond(cell: Cell, face: int) -> Cell:
    return tuple(at + step for at, step in zip(cell, STEPS[face], strict=True))


def maze(blocks: int, seed: int = 0, loops: float = 0.15, layers: int = 1) -> Level:
    """A random maze: a tree of blocks grown cell by cell, with a passage through a share `loops` of the walls between others.

    Raises `SpecError` for fewer than one block or layer.
    """
    if blocks < 1 or layers < 1 or not 0 <= loops <= 1:
        raise SpecError(
            "a maze needs at least 1 block and 1 layer, and a share of loops from 0 to 1, not"
            f" {blocks}, {layers} and {loops}"
        )
    random = np.random.default_rng(seed)
    cells: list[Cell] = [(0, 0, 0)]
    passages, ways = set(), _MAZE[layers > 1]
    while len(cells) < blocks:
        cell = (
            cells[random.integers(max(0, len(cells) - 4), len(cells))]
            if random.random() < 0.8
            else cells[random.integers(len(cells))]
        )
        other = _beyond(cell, ways[random.integers(len(ways))])
        if other not in cells and 0 <= other[1] < layers:
            passages.add(frozenset((cell, other)))
            cells.append(other)
    walls = set()
    for cell in cells:
        for face in (face for face in ways if face in (0, 5, 2)):
            pair = frozenset((cell, _beyond(cell, face)))
            if len(pair & set(cells)) == 2 and pair not in passages and random.random() >= loops:
                walls.add(pair)
    return Level(tuple(cells), frozenset(walls))


def load_level(path: Path) -> Level:
    """A level from TOML: `blocks` as [column, layer, row] or [column, row], and optional `walls` as pairs of those.

    Raises `SpecError` where the file cannot be read as such.
    """
    return read_level(path)[0]


def read_level(path: Path, others: tuple[str, ...] = ()) -> tuple[Level, dict[str, Any]]:
    """A level from TOML as `load_level` has it, and all that the file says. `others` are keys that it may have besides."""
    try:
        read = tomllib.loads(path.read_text(encoding="utf-8"))
        cells = tuple(tuple(map(int, cell)) for cell in read["blocks"])
        walls = frozenset(frozenset(tuple(map(int, cell)) for cell in pair) for pair in read.get("walls", []))
    except (OSError, KeyError, TypeError, ValueError) as reason:
        raise SpecError(f"{path} describes no level ({reason}); give `blocks = [[0, 0], [1, 0]]`") from reason
    unknown = set(read) - {"blocks", "walls", *others}
    if unknown:
        raise SpecError(f"{path} has the unknown keys {sorted(unknown)}; a level has `blocks` and `walls`")
    return Level(cells, walls), read


class LevelTransfer(eqx.Module):
    """Indirect light of a level from the radiosity of its blocks' samples; differentiable in that and in all matrices.

    Blocks N, each the entry `kind` of the dictionary in a `pose`, which `back` undoes; `turns` [P, n] has the samples in all P
    poses, for cubes the 24 of `rotations`. E pairs (interface, source), by interface: `pair_to`, `pair_from`, and `pairs`
    [E, R, B]. Interfaces I with the block that each `enters`, and `along`, the pose in which what enters lights it: for cubes
    the face towards which its light goes.
    """

    dictionary: Operators
    kind: Int[Array, " N"]
    pose: Int[Array, " N"]
    back: Int[Array, " N"]
    turns: Int[Array, "P n"]
    pairs: Float[Array, "E R B"]
    pair_to: Int[Array, " E"]
    pair_from: Int[Array, " E"]
    enters: Int[Array, " I"]
    along: Int[Array, " I"]
    solid: Float[Array, "N n"]

    def coefficients(self, radiosity: Float[Array, "N n C"]) -> Float[Array, "N B C"]:
        """b of every block."""
        turned = jnp.take_along_axis(radiosity, self.turns[self.back][:, :, None], axis=1)
        return jnp.einsum("nbs,nsc->nbc", self.dictionary.read[self.kind], turned, precision="highest")

    def arriving(self, b: Float[Array, "N B C"]) -> Float[Array, "I R C"]:
        """r of every interface: what enters through it from all blocks."""
        parts = jnp.einsum("erb,ebc->erc", self.pairs, b[self.pair_from], precision="highest")
        return jax.ops.segment_sum(parts, self.pair_to, len(self.enters), indices_are_sorted=True)

    def indirect(self, b: Float[Array, "N B C"], r: Float[Array, "I R C"]) -> Float[Array, "N n C"]:
        """Irradiance at every block's samples; 0 on missing faces."""
        own = jnp.einsum("nsb,nbc->nsc", self.dictionary.basis[self.kind], b, precision="highest")
        own = jnp.take_along_axis(own, self.turns[self.pose][:, :, None], axis=1)
        entered = jnp.einsum("sr,irc->isc", self.dictionary.arriving, r, precision="highest")
        entered = jnp.take_along_axis(entered, self.turns[self.along][:, :, None], axis=1)
        return (own + jax.ops.segment_sum(entered, self.enters, len(self.kind))) * self.solid[:, :, None]

    def __call__(
        self, direct: Float[Array, "N n C"], albedo: Float[Array, "N n C"] | float, bounces: int = 1
    ) -> Float[Array, "N n C"]:
        """Indirect irradiance after so many bounces, each from what the one before it left."""
        return self.indirect(*self.bounced(direct, albedo, bounces))

    def bounced(
        self, direct: Float[Array, "N n C"], albedo: Float[Array, "N n C"] | float, bounces: int = 1
    ) -> tuple[Float[Array, "N B C"], Float[Array, "I R C"]]:
        """b and r of the light after so many bounces, at least one."""
        b = self.coefficients(albedo * direct)
        r = self.arriving(b)
        for _ in range(bounces - 1):
            b = self.coefficients(albedo * (direct + self.indirect(b, r)))
            r = self.arriving(b)
        return b, r


def transfer(level: Level, dictionary: Dictionary, depth: int = 8, tolerance: float = 1e-3) -> LevelTransfer:
    """Carry every block's lightfields through up to `depth` interfaces, and set up the operators of the level.

    Of the pairs of one source the weakest are left out, as many as together hold `tolerance`² of the squares of all. Raises
    `SpecError` for a dictionary of flat levels where light goes up or down.
    """
    if level.dimension > dictionary.dimension:
        raise SpecError(
            "light goes up or down in a level whose dictionary is of flat levels; take one of `dimension=3`"
        )
    doors, passages = level.open, Passages(dictionary)
    entries = [entry_of(faces) for faces in doors]
    # An interface is the block that it enters and the face towards which its light goes.
    interfaces = [(other, face) for faces in doors for face, other in faces.items()]
    leaving = [
        {(other, face): passages.leaving(*entry, face) for face, other in faces.items()} if len(faces) < FACES else {}
        for entry, faces in zip(entries, doors, strict=True)
    ]  # without a surface no light of its own
    onwards = {
        (block, along): [
            ((beyond, exit_), passages.onwards(along, exit_))
            for exit_, beyond in doors[block].items()
            if exit_ != along ^ 1  # straight rays do not come back through where they enter
        ]
        for block, along in interfaces
    }
    shape = len(passages.arrive), dictionary.basis.shape[2]
    found = carried(leaving, onwards, dict.fromkeys(interfaces, passages.arrive), shape, depth, tolerance)
    here = np.array([[face not in faces for face in range(FACES)] for faces in doors])
    return LevelTransfer(
        dictionary,
        jnp.array([kind for kind, _ in entries]),
        jnp.array([pose for _, pose in entries]),
        jnp.array([INVERSE[pose] for _, pose in entries]),
        jnp.array(turns(dictionary.side)),
        jnp.asarray(found.pairs, jnp.float32),
        jnp.asarray(found.to, jnp.int32),
        jnp.asarray(found.source, jnp.int32),
        jnp.array([block for block, _ in interfaces], jnp.int32),
        jnp.array([along for _, along in interfaces], jnp.int32),
        jnp.asarray(np.repeat(here, dictionary.side**2, axis=1), jnp.float32),
    )
