"""A tunnel's light as one image: a tile for each piece, around it along u and along it along v, as `Tiles` have it.

The border of a tile is what goes on there: around, its own other side; along, the first or last row of the piece beside it, or
its own at an open end. A bilinear lookup anywhere on the wall is then what `Tunnel.interpolation` has.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SpecError
from prt_bench.modular.tiles import Tiles
from prt_bench.modular.tunnel import Tunnel
from prt_bench.points import Lightmap
from prt_bench.scene import Mesh

_BEYOND = 0.05
"""How far along a triangle may reach beyond its piece."""


@dataclass(frozen=True)
class TunnelAtlas(Tiles):
    """Tiles of `tunnel` with `side`² samples, in the order of its pieces."""

    tunnel: Tunnel
    side: int
    faces: ClassVar[int] = 1

    @property
    def blocks(self) -> int:
        """Pieces of the tunnel."""
        return len(self.tunnel.pieces)

    @cached_property
    def across(self) -> int:
        """Tiles along a side of the image."""
        return int(np.ceil(np.sqrt(self.blocks)))

    @cached_property
    def source(self) -> Int[np.ndarray, " texels"]:
        """The sample (piece · n + its row) that each texel shows, row 0 at v = 0; −1 where no tile is."""
        side, wide = self.side, self.side + 2
        found = np.full((self.across, wide, self.across, wide), -1)
        around = np.arange(-1, side + 1) % side
        for piece in range(self.blocks):
            own = piece * side**2 + np.arange(side)[:, None] * side + around
            ends = []
            for step, row in ((-1, side - 1), (1, 0)):
                other = self.tunnel.beside(piece, step)
                at = (piece, side - 1 - row) if other is None else (other, row)
                ends.append((at[0] * side**2 + at[1] * side + around)[None])
            found[piece // self.across, :, piece % self.across] = np.concatenate([ends[0], own, ends[1]])
        return found.ravel()

    def lightmap(self, mesh: Mesh, edge: float) -> Lightmap:
        """The image for a mesh on the tunnel's walls, `edge` metres a cell.

        Raises `SpecError` for a triangle that lies in no piece, or in several.
        """
        corners = mesh.triangles / edge
        piece, middle = self.tunnel.located(corners.mean(axis=1))
        met = self.tunnel.on_wall(corners.reshape(-1, 3), np.repeat(piece, 3))
        along, around = met.along.reshape(-1, 3), met.around.reshape(-1, 3)
        around += np.round(middle.around[:, None] - around)  # all corners on one side of the seam
        if np.any(np.abs(along - 0.5) > 0.5 + _BEYOND):
            triangle = int(np.argmax(np.abs(along - 0.5).max(axis=1)))
            raise SpecError(
                f"triangle {triangle} of a tunnel's mesh reaches beyond its piece; cut the mesh where its pieces meet"
            )
        uv = self._uv(piece[:, None], np.clip(around, 0.0, 1.0), np.clip(along, 0.0, 1.0))
        return Lightmap(self.resolution, np.flatnonzero(self.source >= 0), uv, piece)

    def _uv(
        self, piece: Int[np.ndarray, "F 1"], around: Float[np.ndarray, "F 3"], along: Float[np.ndarray, "F 3"]
    ) -> Float[np.ndarray, "F 3 2"]:
        """Coordinates in the image."""
        low = np.stack([piece % self.across, piece // self.across], axis=2) * (self.side + 2) + 1
        return (low + self.side * np.stack([around, along], axis=2)) / self.resolution
