"""Tunnels: pipes one after another, straight or turning left or right on a flat grid, and the light in them.

The first pipe enters cell (0, 0) along +x. A tunnel whose end is its beginning is a ring, of which nothing escapes; any other
is open at both ends, through which nothing enters. What lights it is a `LevelTransfer` like that of a level of blocks: an
interface lies between two pipes, one for each direction of light.
"""

import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from prt_bench.errors import SpecError
from prt_bench.modular.carried import carried
from prt_bench.modular.level import LevelTransfer
from prt_bench.modular.pipe import ALONG, AS_IS, BACK, MIRRORED, SHAPES, Hit, bilinear, orders
from prt_bench.modular.pipe_dictionary import PipeDictionary

Cell = tuple[int, int]
STEPS: tuple[Cell, ...] = ((1, 0), (0, -1), (-1, 0), (0, 1))
"""Columns and rows to the next cell along each heading; the next heading is to the left."""
Piece = Literal["straight", "left", "right"]
PIECES: tuple[Piece, ...] = get_args(Piece)
_TURN: dict[Piece, int] = {"straight": 0, "left": 1, "right": -1}
_FORWARD: dict[Piece, int] = {"straight": AS_IS, "left": AS_IS, "right": MIRRORED}  # of `orders`
_BACKWARD: dict[Piece, int] = {"straight": BACK, "left": ALONG, "right": BACK}
_BEYOND = 1e-3  # of a cell, that a point may lie outside


@dataclass(frozen=True)
class Tunnel:
    """Pipes in a row. Raises `SpecError` for none, for one that is not of `PIECES`, and where the tunnel crosses itself."""

    pieces: tuple[Piece, ...]

    def __post_init__(self) -> None:
        if not self.pieces:
            raise SpecError("a tunnel needs at least one piece")
        for piece in self.pieces:
            if piece not in PIECES:
                raise SpecError(f"a tunnel is made of {', '.join(PIECES)}, not {piece!r}")
        for at, cell in enumerate(self.cells):
            if cell in self.cells[:at]:
                raise SpecError(f"piece {at} of a tunnel crosses piece {self.cells.index(cell)}; turn elsewhere")

    @cached_property
    def headings(self) -> list[int]:
        """The direction in which each piece is entered, of `STEPS`, and that in which the last is left."""
        turns = [_TURN[piece] for piece in self.pieces]
        return [int(each) % len(STEPS) for each in np.cumsum([0, *turns])]

    @cached_property
    def cells(self) -> list[Cell]:
        """Column and row of each piece."""
        steps = [(0, 0), *(STEPS[heading] for heading in self.headings[1:-1])]
        return [(column, row) for column, row in np.cumsum(steps, axis=0).tolist()]

    @cached_property
    def ring(self) -> bool:
        """Whether the end is the beginning."""
        step, last = STEPS[self.headings[-1]], self.cells[-1]
        return self.headings[-1] == 0 and (last[0] + step[0], last[1] + step[1]) == (0, 0)

    def beside(self, piece: int, step: int) -> int | None:
        """The piece that many steps on; None beyond an end."""
        at = piece + step
        return at % len(self.pieces) if self.ring or 0 <= at < len(self.pieces) else None

    def points(
        self, side: int
    ) -> tuple[Float[np.ndarray, "N n 3"], Float[np.ndarray, "N n 3"], Float[np.ndarray, "N n"]]:
        """Positions of every piece's samples, in cells, their inward normals, and shares of the mean area of the piece."""
        middles = (np.arange(side) + 0.5) / side
        along, around = np.repeat(middles, side), np.tile(middles, side)
        parts = [self.place(piece, along, around) for piece in range(len(self.pieces))]
        area = [SHAPES[kind].samples(side)[2][orders(side)[order]] for kind, order in map(_entry, self.pieces)]
        return np.stack([position for position, _ in parts]), np.stack([normal for _, normal in parts]), np.stack(area)

    def place(
        self, piece: int, along: Float[np.ndarray, " n"], around: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Positions and inward normals at fractions along a piece and around it."""
        kind, order = _entry(self.pieces[piece])
        mirrored = order == MIRRORED
        position, normal = SHAPES[kind].place(along, 0.5 - around if mirrored else around)
        matrix = self._turned(piece)
        column, row = self.cells[piece]
        return position @ matrix + [column, 0.0, row], normal @ matrix

    def _turned(self, piece: int) -> Float[np.ndarray, "3 3"]:
        """Rows are what x, y and z of the entry become in the tunnel."""
        (x, z), up = STEPS[self.headings[piece]], [0.0, 1.0, 0.0]
        right = np.array([-z, 0.0, x], float)
        return np.stack([np.array([x, 0.0, z], float), up, -right if self.pieces[piece] == "right" else right])

    def located(self, position: Float[np.ndarray, "P 3"]) -> tuple[Int[np.ndarray, " P"], Hit]:
        """The piece that points on the wall belong to, in cells, and where they lie on it.

        Raises `SpecError` for a point that lies in no piece.
        """
        away = np.abs(position[:, None, [0, 2]] - np.array(self.cells)).max(axis=2)
        piece = np.argmin(away, axis=1)
        if np.any(away.min(axis=1) > 0.5 + _BEYOND):
            lost = position[np.argmax(away.min(axis=1))]
            raise SpecError(f"the point ({', '.join(f'{each:.3g}' for each in lost)}) lies in no piece of the tunnel")
        return piece, self.on_wall(position, piece)

    def on_wall(self, position: Float[np.ndarray, "P 3"], piece: Int[np.ndarray, " P"]) -> Hit:
        """Where points lie on the walls of these pieces, or beyond their ends."""
        along, around = np.zeros(len(position)), np.zeros(len(position))
        for each in np.unique(piece).tolist():
            rows, (kind, order) = piece == each, _entry(self.pieces[each])
            column, row = self.cells[each]
            local = (position[rows] - [column, 0.0, row]) @ self._turned(each).T
            along[rows], found = SHAPES[kind].along(local), SHAPES[kind].around(local)
            around[rows] = np.mod(0.5 - found, 1.0) if order == MIRRORED else found
        return Hit(along, around)

    def interpolation(self, position: Float[np.ndarray, "P 3"], side: int) -> csr_array:
        """[P, N n]: light at points on the wall from light at all samples, across seams too; lengths in cells.

        Raises `SpecError` for a point that lies in no piece.
        """
        piece, hit = self.located(position)
        along, around, weights = bilinear(Hit(np.clip(hit.along, 0.0, 1.0), hit.around), side)
        steps = (along >= side).astype(int) - (along < 0)
        count = len(self.pieces)
        there = [[self.beside(at, step) for step in (-1, 0, 1)] for at in range(count)]
        table = np.array([[at if each is None else each for each in row] for at, row in enumerate(there)])
        gone = np.array([[each is None for each in row] for row in there])
        owner = piece[:, None]
        row = np.where(gone[owner, steps + 1], np.clip(along, 0, side - 1), along % side)
        columns = (table[owner, steps + 1] * side + row) * side + around
        start = np.arange(len(position) + 1) * 4
        return csr_array((weights.ravel(), columns.ravel(), start), shape=(len(position), count * side * side))


def _entry(piece: Piece) -> tuple[int, int]:
    """The entry of the dictionary, and the order that its samples are in."""
    return int(piece != "straight"), _FORWARD[piece]


def random_tunnel(pieces: int, seed: int = 0) -> Tunnel:
    """A random tunnel that crosses itself nowhere, with nothing before its end. Raises `SpecError` for fewer than one piece."""
    if pieces < 1:
        raise SpecError(f"a tunnel needs at least one piece, not {pieces}")
    random = np.random.default_rng(seed)
    tried = [random.permutation(PIECES).tolist()]
    path: list[tuple[Cell, int]] = [((0, 0), 0)]  # where each piece is, and the next would be
    taken: list[Piece] = []
    while len(taken) < pieces:
        if not tried[-1]:  # a dead end: the piece before goes another way
            for stack in (tried, path, taken):
                stack.pop()
            continue
        piece = tried[-1].pop()
        (column, row), heading = path[-1]
        step = STEPS[(heading + _TURN[piece]) % len(STEPS)]
        after = (column + step[0], row + step[1])
        if all(after != cell for cell, _ in path):
            taken.append(piece)
            path.append((after, (heading + _TURN[piece]) % len(STEPS)))
            tried.append(random.permutation(PIECES).tolist())
    return Tunnel(tuple(taken))


def load_tunnel(path: Path) -> Tunnel:
    """A tunnel from TOML: `tunnel = ["straight", "left"]`. Raises `SpecError` where the file cannot be read as such."""
    try:
        read = tomllib.loads(path.read_text(encoding="utf-8"))
        pieces = tuple(read["tunnel"])
    except (OSError, KeyError, TypeError, ValueError) as reason:
        raise SpecError(f'{path} describes no tunnel ({reason}); give `tunnel = ["straight", "left"]`') from reason
    if unknown := set(read) - {"tunnel"}:
        raise SpecError(f"{path} has the unknown keys {sorted(unknown)}; a tunnel has `tunnel` alone")
    return Tunnel(pieces)


def transfer(tunnel: Tunnel, dictionary: PipeDictionary, depth: int = 8, tolerance: float = 1e-3) -> LevelTransfer:
    """Carry every piece's lightfields through up to `depth` interfaces, and set up the operators of the tunnel.

    Radiosity and light are those at `Tunnel.points`; depth and tolerance are as in `carried`.
    """
    leave, ways, arrive, mirror = (
        np.asarray(getattr(dictionary, name), np.float64) for name in ("leave", "onwards", "arrive", "mirror")
    )
    swap = {True: mirror, False: np.eye(len(mirror))}
    leaving, onwards, arrives = [], {}, {}
    for at, piece in enumerate(tunnel.pieces):
        kind, order = _entry(piece)
        ends = [(tunnel.beside(at, step), step) for step in (1, -1)]
        seen = swap[order == MIRRORED]
        leaving.append(
            {(other, step): seen @ leave[kind, end] for end, (other, step) in enumerate(ends) if other is not None}
        )
        for other, step in ends:
            # A bend to the left is one to the right from its other end.
            seen = swap[piece == ("right" if step == 1 else "left")]
            if tunnel.beside(at, -step) is not None:
                arrives[at, step] = arrive[kind] @ seen
                onwards[at, step] = [((other, step), seen @ ways[kind] @ seen)] if other is not None else []
    found = carried(leaving, onwards, arrives, (arrive.shape[1], leave.shape[3]), depth, tolerance)
    samples = dictionary.basis.shape[1]
    # As is or mirrored, 0 or 2, each entry's order is its own inverse, −q mod 4.
    along = [(_FORWARD if step == 1 else _BACKWARD)[tunnel.pieces[at]] for at, step in arrives]
    return LevelTransfer(
        dictionary,
        jnp.array([_entry(piece)[0] for piece in tunnel.pieces]),
        jnp.array([_entry(piece)[1] for piece in tunnel.pieces]),
        jnp.array([_entry(piece)[1] for piece in tunnel.pieces]),  # each order undoes itself
        jnp.asarray(orders(dictionary.side)),
        jnp.asarray(found.pairs, jnp.float32),
        jnp.asarray(found.to, jnp.int32),
        jnp.asarray(found.source, jnp.int32),
        jnp.array([at for at, _ in arrives], jnp.int32),
        jnp.array(along, jnp.int32),
        jnp.ones((len(tunnel.pieces), samples), jnp.float32),
    )
