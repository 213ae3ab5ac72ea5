"""Levels in a scene: planes across x, y and z, in metres, that stretch the cubes of a level onto rooms."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prt_bench.errors import FitError, SpecError
from prt_bench.modular.block import Box
from prt_bench.modular.level import Level, read_level
from prt_bench.points import SurfacePoints

AXES = ("x", "y", "z")
_INWARD = 1e-3  # of a block's size, along the normal: where a point on a wall between two blocks is looked for


@dataclass(frozen=True)
class Placed:
    """A level whose block (i, j, k) reaches from `x[i]` to `x[i + 1]`, from `y[j]` up to `y[j + 1]`, from `z[k]` to `z[k + 1]`.

    Raises `SpecError` for places that do not rise, and for blocks that lie beyond them.
    """

    level: Level
    x: tuple[float, ...]
    y: tuple[float, ...]
    z: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in AXES:
            places = getattr(self, name)
            if len(places) < 2 or not np.all(np.isfinite(places)) or np.any(np.diff(places) <= 0):
                raise SpecError(f"`{name}` of a level must be two or more rising places in metres, not {list(places)}")
        columns, layers, rows = counts = [len(places) - 1 for places in self._places]
        for cell in self.level.cells:
            if not all(0 <= at < count for at, count in zip(cell, counts, strict=True)):
                raise SpecError(
                    f"block {list(cell)} of a level lies beyond its {columns} columns, {layers} layers and {rows} rows;"
                    " give more places in `x`, `y` or `z`, or leave it out"
                )

    @classmethod
    def load(cls, path: Path) -> "Placed":
        """A level from TOML, as `load_level` reads it, with `x`, `y` and `z` besides.

        Raises `SpecError` where the file cannot be read as such.
        """
        level, read = read_level(path, AXES)
        if missing := [name for name in AXES if name not in read]:
            raise SpecError(f"{path} does not say where its blocks are; add {', '.join(missing)} in metres")
        try:
            return cls(level, *(tuple(map(float, read[name])) for name in AXES))
        except (TypeError, ValueError) as reason:
            raise SpecError(f"{path}: {', '.join(AXES)} are lists of numbers in metres ({reason})") from reason

    @property
    def _places(self) -> tuple[tuple[float, ...], ...]:
        return self.x, self.y, self.z

    @cached_property
    def boxes(self) -> list[Box]:
        """Where each block is."""
        found = []
        for cell in self.level.cells:
            low, high = (
                np.array([places[at + end] for places, at in zip(self._places, cell, strict=True)]) for end in (0, 1)
            )
            found.append(Box(low, high - low))
        return found

    def owner(self, points: SurfacePoints) -> Int[np.ndarray, " P"]:
        """The block that each point lies in; a point on a wall belongs to the block that it faces.

        Points beyond the outer places count for the block next to them. Raises `FitError` for a point where no block is.
        """
        at = []
        for axis, places in enumerate(self._places):
            size = np.min(np.diff(places))
            where = points.position[:, axis] + _INWARD * size * points.normal[:, axis]
            at.append(np.clip(np.searchsorted(places, where, side="right") - 1, 0, len(places) - 2))
        table = np.full([len(places) - 1 for places in self._places], -1)
        table[tuple(np.array(self.level.cells).T)] = np.arange(len(self.level.cells))
        found = table[tuple(at)]
        if np.any(found < 0):
            lost = int(np.argmax(found < 0))
            raise FitError(
                f"the point ({', '.join(f'{each:.3g}' for each in points.position[lost])}) lies in cell"
                f" {[int(each[lost]) for each in at]}, where the level has no block; add it to the level's `blocks`"
            )
        return found
