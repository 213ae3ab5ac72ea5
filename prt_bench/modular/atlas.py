"""A level's light as one image: a tile for each face of each block, with a border that goes on where the surface does.

A tile is the face's `side`² samples within a border of one texel. Beyond an edge where the next block has the same face, the
border is that face's nearest row; at corners of the level it repeats its own. A bilinear lookup anywhere on a face is then
what one in the joined surface is, the same from both sides of every seam, and within half a texel of a corner the last texel
stands for it, as in `cube.bilinear`. Where a wall ends, the texel at its foot follows one of the two ways round it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SpecError
from prt_bench.modular.cube import FACES
from prt_bench.modular.level import Level
from prt_bench.modular.tiles import Tiles
from prt_bench.points import Lightmap
from prt_bench.scene import Mesh

_BEYOND = 0.05
"""How far a triangle may reach beyond its block, in edges: walls have a thickness."""


@dataclass(frozen=True)
class LevelAtlas(Tiles):
    """Tiles of `level` with `side`² samples, row by row in the order of `Level.surfaces`."""

    level: Level
    side: int
    faces: ClassVar[int] = FACES

    @property
    def blocks(self) -> int:
        """Blocks of the level."""
        return len(self.level.cells)

    @cached_property
    def across(self) -> int:
        """Tiles along a side of the image."""
        return int(np.ceil(np.sqrt(len(self._tile))))

    @cached_property
    def _tile(self) -> dict[tuple[int, int], int]:
        return {surface: tile for tile, surface in enumerate(self.level.surfaces())}

    @cached_property
    def source(self) -> Int[np.ndarray, " texels"]:
        """The sample (block · n + its row) that each texel shows, row 0 at v = 0; −1 where no tile is."""
        doors, wide = self.level.open, self.side + 2
        found = np.full((self.across, wide, self.across, wide), -1)
        rows, columns = (np.indices((wide, wide)) - 1).reshape(2, -1).tolist()
        for (block, face), tile in self._tile.items():
            samples = [self._shown(doors, block, face, i, j) for i, j in zip(columns, rows, strict=True)]
            found[tile // self.across, :, tile % self.across] = np.reshape(samples, (wide, wide))
        return found.ravel()

    def _shown(self, doors: list[dict[int, int]], block: int, face: int, i: int, j: int) -> int:
        """The sample at column i, row j of a face; either or both may be one step outside: on the next face, or the nearest."""
        place = [i, j]
        for along in (0, 1):
            step = (place[along] >= self.side) - (place[along] < 0)
            after = self._next(doors, block, face, along, step)
            if after is not None:
                place[along] -= step * self.side
                return self._shown(doors, after, face, *place)
        column, row = (min(max(at, 0), self.side - 1) for at in place)
        return (block * FACES + face) * self.side**2 + row * self.side + column

    def _next(self, doors: list[dict[int, int]], block: int, face: int, along: int, step: int) -> int | None:
        """The block whose face of the same kind goes on from this one's, a step along u or v; None where none does."""
        if step == 0:
            return None
        after = doors[block].get(2 * ((face // 2 + 1 + along) % 3) + (step < 0))
        return after if (after, face) in self._tile else None

    def uv(
        self, position: Float[np.ndarray, "P 3"], block: Int[np.ndarray, " P"], face: Int[np.ndarray, " P"]
    ) -> Float[np.ndarray, "P 2"]:
        """Coordinates in the image of points on these faces, in edges of a block. Raises `SpecError` for a missing face."""
        gone = next((pair for pair in zip(block.tolist(), face.tolist(), strict=True) if pair not in self._tile), None)
        if gone is not None:
            raise SpecError(f"a point lies on face {gone[1]} of block {gone[0]} of a level, which is missing")
        tile = np.array([self._tile[pair] for pair in zip(block.tolist(), face.tolist(), strict=True)], int)
        met = self.level.on_face(position, block, face)
        low = np.stack([tile % self.across, tile // self.across], axis=1) * (self.side + 2) + 1
        return (low + self.side * np.stack([met.u, met.v], axis=1)) / self.resolution

    def lightmap(self, mesh: Mesh, edge: float) -> Lightmap:
        """The image for a mesh on the level's faces, `edge` metres a block.

        Raises `SpecError` for a triangle that lies in several blocks.
        """
        corners = mesh.triangles / edge
        block, face = self.level.located(corners.mean(axis=1), mesh.normals)
        away = np.abs(corners - np.array(self.level.cells)[block][:, None]).max(axis=(1, 2))
        if np.any(away > 0.5 + _BEYOND):
            triangle = int(np.argmax(away))
            raise SpecError(
                f"triangle {triangle} of a level's mesh reaches beyond its block; cut the mesh where its blocks meet"
            )
        uv = self.uv(corners.reshape(-1, 3), np.repeat(block, 3), np.repeat(face, 3)).reshape(-1, 3, 2)
        texel = np.flatnonzero(self.source >= 0)
        return Lightmap(self.resolution, texel, uv, block * FACES + face)
