"""Levels in a scene: lines along x and z and two heights, in metres, that stretch the cubes of a level onto rooms."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prt_bench.errors import FitError, SpecError
from prt_bench.modular.block import Box
from prt_bench.modular.level import Level, read_level
from prt_bench.points import SurfacePoints

LINES = ("columns", "rows", "heights")
_INWARD = 1e-3  # of a block's size, along the normal: where a point on a wall between two blocks is looked for


@dataclass(frozen=True)
class Placed:
    """A level whose block (i, j) reaches from `columns[i]` to `columns[i + 1]` in x, from `rows[j]` to `rows[j + 1]` in z, and
    from the first to the second of `heights` in y.

    Raises `SpecError` for lines that do not rise, and for blocks that lie beyond them.
    """

    level: Level
    columns: tuple[float, ...]
    rows: tuple[float, ...]
    heights: tuple[float, float]

    def __post_init__(self) -> None:
        for name in LINES:
            lines = getattr(self, name)
            if not np.all(np.isfinite(lines)) or np.any(np.diff(lines) <= 0):
                raise SpecError(f"the {name} of a level must be numbers that rise, in metres, not {list(lines)}")
        if len(self.heights) != 2:
            raise SpecError(f"a level has two heights, of floor and ceiling, not {list(self.heights)}")
        for column, row in self.level.cells:
            if not (0 <= column < len(self.columns) - 1 and 0 <= row < len(self.rows) - 1):
                raise SpecError(f"block [{column}, {row}] of a level lies beyond its lines; add some, or leave it out")

    @classmethod
    def load(cls, path: Path) -> "Placed":
        """A level from TOML, as `load_level` reads it, with `columns`, `rows` and `heights` besides.

        Raises `SpecError` where the file cannot be read as such.
        """
        level, read = read_level(path, LINES)
        if missing := [name for name in LINES if name not in read]:
            raise SpecError(f"{path} does not say where its blocks are; add {', '.join(missing)} in metres")
        try:
            columns, rows, heights = (tuple(map(float, read[name])) for name in LINES)
        except (TypeError, ValueError) as reason:
            raise SpecError(f"{path}: {', '.join(LINES)} are lists of numbers in metres ({reason})") from reason
        return cls(level, columns, rows, heights)  # pyright: ignore[reportArgumentType]

    @cached_property
    def boxes(self) -> list[Box]:
        """Where each block is."""
        found = []
        for column, row in self.level.cells:
            low = np.array([self.columns[column], self.heights[0], self.rows[row]])
            high = np.array([self.columns[column + 1], self.heights[1], self.rows[row + 1]])
            found.append(Box(low, high - low))
        return found

    def owner(self, points: SurfacePoints) -> Int[np.ndarray, " P"]:
        """The block that each point lies in; a point on a wall belongs to the block that it faces.

        Points beyond the outer lines count for the block next to them. Raises `FitError` for a point where no block is.
        """
        at = []
        for lines, axis in ((self.columns, 0), (self.rows, 2)):
            size = np.min(np.diff(lines))
            where = points.position[:, axis] + _INWARD * size * points.normal[:, axis]
            at.append(np.clip(np.searchsorted(lines, where, side="right") - 1, 0, len(lines) - 2))
        table = np.full((len(self.columns) - 1, len(self.rows) - 1), -1)
        table[tuple(np.array(self.level.cells).T)] = np.arange(len(self.level.cells))
        found = table[at[0], at[1]]
        if np.any(found < 0):
            lost = int(np.argmax(found < 0))
            raise FitError(
                f"the point ({', '.join(f'{each:.3g}' for each in points.position[lost])}) lies in cell"
                f" [{at[0][lost]}, {at[1][lost]}], where the level has no block; add it to the level's `blocks`"
            )
        return found
