"""Cells of a lightmap between whose corners values may be interpolated: where they lie, how they split, and with which weights.

A region is what one value could belong to: texels of one chart that face one way. Each region's bounding box is halved until
its cells are small; whoever drives this says which of them are smooth enough (`nodes.py` asks traced rays). No rays here.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from prt_bench.points import Lightmap, SurfacePoints

LARGEST = 16
"""Side of the largest cell in texels: what is smaller than half of it and casts no wider shadow could be missed."""
_AT_ONCE = 1 << 15


def regions(lightmap: Lightmap, points: SurfacePoints, buried: Bool[np.ndarray, " T"]) -> Int[np.ndarray, "H W"]:
    """The region of each texel, −1 where there is no receiver. Buried receivers are regions of their own."""
    facing = np.round(points.normal, 5) + 0.0
    _, region = np.unique(np.column_stack([lightmap.chart[points.face], buried, facing]), axis=0, return_inverse=True)
    return lightmap.image(region.reshape(-1, 1).astype(np.int32), -1)[..., 0]


class Cells:
    """n cells [x0, x1] × [y0, y1] of texels, borders included, each within one region of the image `home`."""

    def __init__(
        self,
        home: Int[np.ndarray, "H W"],
        region: Int[np.ndarray, " n"],
        x: Int[np.ndarray, "n 2"],
        y: Int[np.ndarray, "n 2"],
    ) -> None:
        self.home, self.region, self.x, self.y = home, region, x, y

    @classmethod
    def whole(cls, home: Int[np.ndarray, "H W"]) -> "Cells":
        """The bounding boxes of all regions, halved until no side is over `LARGEST`; empty ones left out."""
        row, column = np.nonzero(home >= 0)
        region = home[row, column]
        count = int(region.max(initial=-1)) + 1
        least, most = np.full((2, count), home.size), np.zeros((2, count), int)
        for axis, place in enumerate((column, row)):
            np.minimum.at(least[axis], region, place)
            np.maximum.at(most[axis], region, place)
        cells = cls(home, np.arange(count), *(np.stack([least[axis], most[axis]], axis=1) for axis in (0, 1)))
        while cells.size.max(initial=0) > LARGEST:
            cells = cells.halved(LARGEST)
        return cells.occupied()

    def __len__(self) -> int:
        return len(self.region)

    def __getitem__(self, chosen: np.ndarray | slice) -> "Cells":
        return Cells(self.home, self.region[chosen], self.x[chosen], self.y[chosen])

    @property
    def size(self) -> Int[np.ndarray, "n 2"]:
        """Extent along x and y, 0 for a single texel."""
        return np.stack([self.x[:, 1] - self.x[:, 0], self.y[:, 1] - self.y[:, 0]], axis=1)

    @property
    def small(self) -> Bool[np.ndarray, " n"]:
        """Cells whose texels are all among their nine nodes."""
        return np.all(self.size <= 2, axis=1)

    def halved(self, least: int = 2) -> "Cells":
        """Both halves along every side that is longer than `least`; halves share the texels they meet at."""
        cells = self
        for axis in (0, 1):
            long = cells.size[:, axis] > least
            spans = (cells.x, cells.y)
            middle = spans[axis].sum(axis=1) // 2
            low, high = spans[axis].copy(), spans[axis][long].copy()
            low[long, 1] = middle[long]
            high[:, 0] = middle[long]
            other = spans[1 - axis]
            both = np.concatenate([low, high]), np.concatenate([other, other[long]])
            region = np.concatenate([cells.region, cells.region[long]])
            cells = Cells(self.home, region, *(both if axis == 0 else both[::-1]))
        return cells

    def occupied(self) -> "Cells":
        """Those with any texel of their region."""
        return self[np.concatenate([np.zeros(0, bool), *(inside.any(axis=1) for _, _, inside in self._blocks())])]

    def texels(self) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
        """Flat indices of all texels of their regions in the cells, and which cell each is found in."""
        found, owner, first = [np.zeros(0, int)], [np.zeros(0, int)], 0
        for row, column, inside in self._blocks():
            at, place = np.nonzero(inside)
            found.append(row[at, place] * self.home.shape[1] + column[at, place])
            owner.append(at + first)
            first += len(inside)
        return np.concatenate(found), np.concatenate(owner)

    def nodes(self) -> Int[np.ndarray, "n 3 3"]:
        """Flat indices of corners, edge middles and the middle, by row and column."""
        x, y = (np.insert(span, 1, span.sum(axis=1) // 2, axis=1) for span in (self.x, self.y))
        return y[:, :, None] * self.home.shape[1] + x[:, None, :]

    def complete(self) -> Bool[np.ndarray, " n"]:
        """Cells whose nine nodes all belong to their region."""
        return np.all(self.home.ravel()[self.nodes()] == self.region[:, None, None], axis=(1, 2))

    def corner_weights(self) -> Float[np.ndarray, "n 3 3 4"]:
        """Shares of the four corners (by rows) in a bilinear prediction at the nine nodes; a corner's own is 1."""
        along, across = (_shares(np.insert(s, 1, s.sum(axis=1) // 2, axis=1), s[:, None]) for s in (self.x, self.y))
        return np.einsum("njr,nic->njirc", across, along).reshape(len(self), 3, 3, 4)

    def between(
        self, texel: Int[np.ndarray, " m"], owner: Int[np.ndarray, " m"]
    ) -> tuple[Int[np.ndarray, "m 4"], Float[np.ndarray, "m 4"]]:
        """For texels in the cells `owner`: the four of its nodes around each, and their bilinear shares."""
        row, column = np.divmod(texel, self.home.shape[1])
        spans = []
        for span, place in ((self.y, row), (self.x, column)):
            middle = span.sum(axis=1)[owner] // 2
            after = place > middle
            spans.append(
                np.stack([np.where(after, middle, span[owner, 0]), np.where(after, span[owner, 1], middle)], 1)
            )
        y, x = spans
        corner = y[:, :, None] * self.home.shape[1] + x[:, None, :]
        along, across = _shares(column[:, None], x[:, None])[:, 0], _shares(row[:, None], y[:, None])[:, 0]
        return corner.reshape(-1, 4), np.einsum("mr,mc->mrc", across, along).reshape(-1, 4)

    def _blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Some cells at a time: rows [b, p] and columns [b, p] of texels, and which of them lie in their cell and region."""
        for at in range(0, len(self), _AT_ONCE):
            part = self[at : at + _AT_ONCE]
            side = np.arange(int(part.size.max(initial=0)) + 1)
            dy, dx = (offsets.ravel() for offsets in np.meshgrid(side, side, indexing="ij"))
            row, column = part.y[:, :1] + dy, part.x[:, :1] + dx
            inside = (row <= part.y[:, 1:]) & (column <= part.x[:, 1:])
            row, column = np.minimum(row, part.y[:, 1:]), np.minimum(column, part.x[:, 1:])
            yield row, column, inside & (self.home[row, column] == part.region[:, None])


def _shares(place: Int[np.ndarray, "n p"], span: Int[np.ndarray, "n 1 2"]) -> Float[np.ndarray, "n p 2"]:
    """Linear shares of a span's two ends at places in it; the first end has all where they are one."""
    length = np.maximum(span[..., 1] - span[..., 0], 1)
    second = (place - span[..., 0]) / length
    return np.stack([1.0 - second, second], axis=-1)
