"""Strands of hair: polylines with a thickness, the tubes that rays and frames see of them, and their own texels.

A strand has `TEXELS` texels from root to tip, whatever it looks like around: light on it is a mean over its circumference.
Growing strands on a mesh, and placing their texels in a lightmap, is left to `data_gen`; what a fibre does to light is in
`hair.py`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from prt_bench.errors import SceneError
from prt_bench.hemisphere import tangent_frames

TEXELS = 10
"""Texels of a strand, along its length (Belcour et al. 2022, Section 6.3)."""
SIDES = 3
"""Faces around a tube: the fewest that have a width from everywhere."""


@dataclass(frozen=True)
class Strands:
    """s strands: `nodes` [n, 3] in metres from root to tip, strand by strand, of which strand i has those from `starts[i]` up
    to `starts[i + 1]`, at least two; `radius` [s] of its fibre in metres and `material` [s].

    Raises `SceneError` for numbers that are not finite, strands without length and radii that are not above zero.
    """

    nodes: Float[np.ndarray, "n 3"]
    starts: Int[np.ndarray, " s+1"]
    radius: Float[np.ndarray, " s"]
    material: Int[np.ndarray, " s"]

    def __post_init__(self) -> None:
        if len(self) == 0:
            raise SceneError("there are no strands of hair; grow some, or leave the hair out")
        if np.any(np.diff(self.starts) < 2):
            raise SceneError("a strand of hair needs at least two nodes, its root and its tip")
        if not np.all(np.isfinite(self.nodes)):
            raise SceneError("strands of hair have nodes that are not finite numbers")
        if not np.all((self.radius > 0) & np.isfinite(self.radius)):
            raise SceneError("strands of hair need a radius above zero metres")
        if not np.all(self.segments > 0):
            raise SceneError("a strand of hair has two nodes in one place; drop strands and segments without length")

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def first(self) -> Int[np.ndarray, " segments"]:
        """Node where each segment begins; it ends at the next one."""
        begins = np.ones(len(self.nodes), bool)
        begins[self.starts[1:] - 1] = False
        return np.flatnonzero(begins)

    @cached_property
    def owner(self) -> Int[np.ndarray, " n"]:
        """Strand of each node."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    @cached_property
    def segments(self) -> Float[np.ndarray, " segments"]:
        """Length of each segment in metres."""
        return np.linalg.norm(self.nodes[self.first + 1] - self.nodes[self.first], axis=1)

    @cached_property
    def along(self) -> Float[np.ndarray, " n"]:
        """Where nodes lie on their strand, from 0 at the root to 1 at the tip."""
        walked = np.zeros(len(self.nodes))
        walked[self.first + 1] = self.segments
        total = np.cumsum(walked)
        length = total[self.starts[1:] - 1] - total[self.starts[:-1]]
        return (total - total[self.starts[:-1]][self.owner]) / length[self.owner]

    @cached_property
    def tangents(self) -> Float[np.ndarray, "segments 3"]:
        """Unit direction of each segment, towards the tip."""
        return (self.nodes[self.first + 1] - self.nodes[self.first]) / self.segments[:, None]

    @property
    def clearance(self) -> Float[np.ndarray, " s"]:
        """Distance from the axis that is outside of the strand's tube, in metres."""
        return 1.25 * tube_radius(self.radius)

    def at(
        self, strand: Int[np.ndarray, " p"], along: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, " p"]]:
        """Points on the axes of strands, and the segments that they lie on."""
        # Every strand begins at an integer, so that one search serves all of them.
        place = self.along + self.owner
        place[self.starts[1:] - 1] = self.owner[self.starts[1:] - 1] + 1.0
        node = np.searchsorted(place, strand + along, side="right") - 1
        node = np.clip(node, self.starts[strand], self.starts[strand + 1] - 2)
        share = (along - self.along[node]) / (self.along[node + 1] - self.along[node])
        share = np.clip(share, 0.0, 1.0)[:, None]
        return (1.0 - share) * self.nodes[node] + share * self.nodes[node + 1], node - self.owner[node]

    @cached_property
    def corners(self) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, "F 3"]]:
        """Node and side of each corner of the tubes' faces, segment by segment: six faces each, and three towards a tip."""
        tip = np.isin(self.first + 1, self.starts[1:] - 1)
        rows = []
        for side in range(SIDES):
            low, high, after = self.first, self.first + 1, (side + 1) % SIDES
            rows.append((low, low, high, side, after, side, np.ones(len(low), bool)))
            rows.append((low, high, high, after, after, side, ~tip))
        node = np.stack([np.stack(row[:3], axis=1) for row in rows], axis=1)
        side = np.broadcast_to(np.array([row[3:6] for row in rows]), node.shape)
        kept = np.stack([row[6] for row in rows], axis=1)
        return node[kept], side[kept]

    @cached_property
    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """Corners of the tubes around the nodes, side by side; a tip has one, three times."""
        tangent = np.zeros_like(self.nodes)
        tangent[self.first] += self.tangents
        tangent[self.first + 1] += self.tangents
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        fallback = np.zeros_like(tangent)
        fallback[self.first] = self.tangents
        tangent = np.where(length > 1e-6, tangent / np.maximum(length, 1e-6), fallback)
        across = self._carried(tangent)
        other = np.cross(tangent, across)
        radius = tube_radius(self.radius)[self.owner]
        radius[self.starts[1:] - 1] = 0.0
        angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
        ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * other[:, None]
        return (self.nodes[:, None] + radius[:, None, None] * ring).reshape(-1, 3)

    def _carried(self, tangent: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """A direction across each node's tangent, carried along the strand without twist; turned at random at the root."""
        turn = 2.0 * np.pi * np.mod(0.6180339887498949 * np.arange(len(self)), 1.0)
        across = np.zeros_like(tangent)
        root = self.starts[:-1]
        across[root] = tangent_frames(tangent[root], turn)[:, 0]
        for step in range(1, int(np.diff(self.starts).max())):
            node = root[root + step < self.starts[1:]] + step
            bent = across[node - 1] - np.sum(across[node - 1] * tangent[node], 1, keepdims=True) * tangent[node]
            length = np.linalg.norm(bent, axis=1, keepdims=True)
            fresh = tangent_frames(tangent[node], np.zeros(len(node)))[:, 0]
            across[node] = np.where(length > 1e-6, bent / np.maximum(length, 1e-6), fresh)
        return across

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Faces of the tubes as corners among `vertices`, fronts outward."""
        node, side = self.corners
        return SIDES * node + side


def tube_radius(radius: Float[np.ndarray, " s"]) -> Float[np.ndarray, " s"]:
    """From the axis to the corners of a tube that is, on average over all sides, as wide as a fibre of that radius.

    The mean width of a convex section is its perimeter over π (Cauchy): 2 r = 2 R · SIDES sin(π/SIDES) / π.
    """
    return radius * np.pi / (SIDES * np.sin(np.pi / SIDES))
