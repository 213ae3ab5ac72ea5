"""Triangles in texture space onto texels: which texels each overlaps, and the point of it nearest to each centre.

Conservative, vectorised and chunked; knows nothing of scenes or charts' origin.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

PAIRS_PER_CHUNK = 1 << 18
"""Triangle-texel pairs examined at once; bounds the memory to some 100 MB."""
_TOUCH = 1e-4  # texels by which a triangle must reach into a texel to overlap it
_INSET = 0.05  # texels by which points are drawn in from the edges of their triangle


def rasterise(
    corner_uv: Float[np.ndarray, "F 3 2"], drawn: Bool[np.ndarray, " F"], resolution: int
) -> tuple[Int[np.ndarray, " T"], Int[np.ndarray, " T"], Float[np.ndarray, "T 3"]]:
    """Covered texels (flat index, ascending), and for each the face and barycentric coordinates of its point.

    A face that holds the centre wins, then the face nearest to it, then the lower index.
    """
    columns = [[], [], [], []]
    for texel, face, distance, barycentric in _overlapping(corner_uv * resolution, drawn, resolution):
        for column, values in zip(columns, (texel, face, distance, barycentric), strict=True):
            column.append(values)
    texel, face, distance, barycentric = (np.concatenate(column) for column in columns)
    order = np.lexsort((face, distance, texel))
    first = order[np.flatnonzero(np.diff(texel[order], prepend=-1))]
    return texel[first], face[first], _inset(barycentric[first], corner_uv[face[first]] * resolution)


def overlaps(corner_uv: Float[np.ndarray, "F 3 2"], chart: Int[np.ndarray, " F"], resolution: int) -> bool:
    """Whether two charts share a texel, or two faces hold the same texel centre inside them."""
    inside = np.zeros(resolution**2, bool)
    owner = np.full(resolution**2, -1)
    for texel, face, _, barycentric in _overlapping(corner_uv * resolution, np.ones(len(chart), bool), resolution):
        within = texel[barycentric.min(axis=1) > 1e-6]
        if inside[within].any() or len(np.unique(within)) < len(within):
            return True
        inside[within] = True
        # Writing and reading back finds conflicts inside the chunk as well as with earlier ones.
        taken = owner[texel] >= 0
        if np.any(owner[texel][taken] != chart[face][taken]):
            return True
        owner[texel] = chart[face]
        if np.any(owner[texel] != chart[face]):
            return True
    return False


def _overlapping(
    corners: Float[np.ndarray, "F 3 2"], drawn: Bool[np.ndarray, " F"], resolution: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Chunks of (texel, face, squared distance of the nearest point from the centre, its barycentrics)."""
    low = np.floor(corners.min(axis=1) + _TOUCH).astype(int)
    high = np.ceil(corners.max(axis=1) - _TOUCH).astype(int) - 1
    low, high = np.clip(low, 0, resolution - 1), np.clip(np.maximum(low, high), 0, resolution - 1)
    size = np.where(drawn[:, None], high - low + 1, 0)
    pairs = size.prod(axis=1)
    start = 0
    ends = np.cumsum(pairs)
    while start < len(pairs):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + PAIRS_PER_CHUNK, side="right")))
        face = np.repeat(np.arange(start, stop), pairs[start:stop])
        local = np.arange(len(face)) - np.repeat(ends[start:stop] - pairs[start:stop] - done, pairs[start:stop])
        column, row = low[face, 0] + local % size[face, 0], low[face, 1] + local // size[face, 0]
        relative = corners[face] - np.stack([column, row], axis=1)[:, None] - 0.5
        touched = _touches(relative)
        distance, barycentric = _nearest(relative[touched])
        yield (row * resolution + column)[touched], face[touched], distance, barycentric
        start = stop


def _touches(corners: Float[np.ndarray, "n 3 2"]) -> Bool[np.ndarray, " n"]:
    """Separating-axis test of triangles against the unit square about the origin (its own axes: the bounding box)."""
    edge = np.roll(corners, -1, axis=1) - corners
    normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
    projected = np.einsum("ned,ncd->nec", normal, corners)
    length = np.linalg.norm(normal, axis=-1)
    reach = 0.5 * np.abs(normal).sum(axis=-1) - _TOUCH * length
    apart = (projected.min(axis=-1) > reach) | (projected.max(axis=-1) < -reach)
    return ~np.any(apart & (length > 0), axis=1)


def _nearest(corners: Float[np.ndarray, "n 3 2"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Squared distance from the origin to each triangle and the barycentrics of the nearest point."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    weights = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    doubled = weights.sum(axis=1)
    barycentric = weights / np.where(doubled == 0, 1.0, doubled)[:, None]
    distance = np.zeros(len(corners))
    outside = np.flatnonzero((barycentric.min(axis=1) < 0) | (doubled == 0))
    distance[outside] = np.inf
    for i, j in ((0, 1), (1, 2), (2, 0)):
        p, q = corners[outside, i], corners[outside, j]
        edge = q - p
        squared = np.einsum("nd,nd->n", edge, edge)
        t = np.clip(-np.einsum("nd,nd->n", p, edge) / np.where(squared == 0, 1.0, squared), 0.0, 1.0)
        gap = np.sum((p + t[:, None] * edge) ** 2, axis=1)
        closer = gap < distance[outside]
        at = outside[closer]
        distance[at] = gap[closer]
        barycentric[at] = 0.0
        barycentric[at, i], barycentric[at, j] = 1.0 - t[closer], t[closer]
    return distance, barycentric


def _inset(barycentric: Float[np.ndarray, "n 3"], corners: Float[np.ndarray, "n 3 2"]) -> Float[np.ndarray, "n 3"]:
    """Keep points `_INSET` texels away from every edge, as far as the triangle is wide enough."""
    opposite = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1), axis=-1)
    edges = corners[:, 1:] - corners[:, :1]
    doubled = np.abs(_cross(edges[:, 0], edges[:, 1]))[:, None]
    least = np.minimum(_INSET * opposite, 0.1 * doubled) / np.where(doubled == 0, 1.0, doubled)
    # What the raised coordinates gain is taken from the others in proportion to what these can give.
    raised = np.maximum(barycentric, least)
    spare = raised - least
    excess = raised.sum(axis=1, keepdims=True) - 1.0
    return raised - excess * spare / np.maximum(spare.sum(axis=1, keepdims=True), np.finfo(float).tiny)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
