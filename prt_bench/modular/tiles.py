"""The image of light that a runtime draws from: square tiles of samples, row by row, each within a border of one texel."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Int

from prt_bench.points import Lightmap
from prt_bench.scene import Mesh


class Tiles(ABC):
    """`side`² samples a tile. Blocks have `faces`, each of them a tile where it is there."""

    side: int
    faces: ClassVar[int]

    @property
    @abstractmethod
    def blocks(self) -> int:
        """Blocks of the level."""

    @property
    @abstractmethod
    def source(self) -> Int[np.ndarray, " texels"]:
        """The sample (block · n + its row) that each texel shows, row 0 at v = 0; −1 where no tile is."""

    @abstractmethod
    def lightmap(self, mesh: Mesh, edge: float) -> Lightmap:
        """The image for a mesh on the level's surfaces, `edge` metres a block."""

    @property
    @abstractmethod
    def across(self) -> int:
        """Tiles along a side of the image."""

    @property
    def shape(self) -> tuple[int, int]:
        """Blocks, and samples of each."""
        return self.blocks, self.faces * self.side**2

    @property
    def resolution(self) -> int:
        """Texels along a side of the image."""
        return self.across * (self.side + 2)
