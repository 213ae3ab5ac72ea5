"""Lightmaps of scenes with hair: the surfaces' charts in a square of their own, and rows of strands beyond it.

A strand has `TEXELS` texels side by side, from root to tip; strands lie one after another in rows of the image, as in Belcour
et al. 2022, Section 6.3. Texture coordinates run along texel centres, so that no lookup reaches the next strand.
"""

from math import ceil
from pathlib import Path

import numpy as np
from jaxtyping import Int

from data_gen.atlas import surface_points, unwrap
from data_gen.raster import rasterise
from data_gen.strands import without_strands
from prt_bench.errors import SceneError, SpecError
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Scene
from prt_bench.strands import TEXELS

_LEAST = 8  # texels on a side that surfaces need


def strand_rows(scene: Scene, resolution: int) -> int:
    """Rows of a lightmap that the strands take. Raises `SceneError` where they leave the surfaces no room."""
    assert scene.strands is not None
    rows = ceil(len(scene.strands) / max(resolution // TEXELS, 1)) if resolution >= TEXELS else resolution + 1
    if rows + (_LEAST if scene.surfaces else 0) > resolution:
        least = ceil((TEXELS * len(scene.strands)) ** 0.5) + TEXELS + _LEAST
        raise SceneError(
            f"the {len(scene.strands)} strands of '{scene.name}' need {TEXELS} texels each, which {resolution}² texels do not"
            f" hold beside its surfaces; ask for {least} or more"
        )
    return rows


def unwrap_with_strands(
    scene: Scene, resolution: int, folder: Path | None = None, mips: int = 0, texture_set: bool = False
) -> Lightmap:
    """The lightmap of a scene with hair; see `atlas.unwrap`. Raises `SpecError` for halved images, which mix strands."""
    if mips:
        raise SpecError(f"scene '{scene.name}' has hair, whose texels cannot be halved; leave mips out")
    assert scene.strands is not None
    rows, surfaces = strand_rows(scene, resolution), scene.surfaces
    corner_uv = np.zeros((len(scene.mesh.faces), 3, 2))
    chart = np.full(len(scene.mesh.faces), -1, np.int32)
    side, charts = resolution - rows, 0
    if surfaces:
        flat = unwrap(without_strands(scene), side, folder, 0, texture_set)
        corner_uv[:surfaces] = flat.corner_uv * (side / resolution)
        chart[:surfaces] = flat.chart
        charts = int(flat.chart.max()) + 1
    strands = scene.strands
    node, _ = strands.corners
    owner = strands.owner[node[:, 0]]
    row, column = np.divmod(owner, resolution // TEXELS)
    u = column[:, None] * TEXELS + 0.5 + (TEXELS - 1) * strands.along[node]
    v = np.broadcast_to((side + row + 0.5)[:, None], u.shape)
    corner_uv[surfaces:] = np.stack([u, v], axis=2) / resolution
    chart[surfaces:] = charts + owner
    texel = rasterise(corner_uv[:surfaces], chart[:surfaces] >= 0, resolution)[0] if surfaces else np.zeros(0, int)
    every = np.arange(len(strands) * TEXELS)
    row, column = np.divmod(every // TEXELS, resolution // TEXELS)
    at_strands = (side + row) * resolution + column * TEXELS + every % TEXELS
    return Lightmap(resolution, np.concatenate([texel, at_strands]).astype(texel.dtype), corner_uv, chart, 0)


def points_with_strands(scene: Scene, lightmap: Lightmap) -> SurfacePoints:
    """The receivers of a scene with hair, in the order of `lightmap.texel`: surfaces first, then strand by strand."""
    assert scene.strands is not None
    surfaces, strands = scene.surfaces, scene.strands
    parts = []
    if surfaces:
        inside = lightmap.chart[:surfaces] >= 0
        _, face, barycentric = rasterise(lightmap.corner_uv[:surfaces], inside, lightmap.resolution)
        parts.append(surface_points(scene, face, barycentric))
    owner = np.repeat(np.arange(len(strands)), TEXELS)
    position, segment = strands.at(owner, np.tile(TEXEL_MIDDLES, len(strands)))
    face = surfaces + _first_faces(scene)[segment]
    albedo = np.array([m.albedo for m in scene.materials], float)[strands.material[owner]]
    barycentric = np.full((len(owner), 3), 1.0 / 3.0)
    clear = strands.clearance[owner]
    parts.append(SurfacePoints(position, strands.tangents[segment], albedo, face, barycentric, clear))
    if len(parts) == 1:
        return parts[0]
    names = ("position", "normal", "albedo", "face", "barycentric")
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    return SurfacePoints(*joined, clearance=np.concatenate([np.zeros(len(parts[0])), clear]))


def texel_edges() -> np.ndarray:
    """Where the texels of a strand begin and end along it: that at the root and that at the tip are half as long."""
    return np.clip((np.arange(TEXELS + 1) - 0.5) / (TEXELS - 1), 0.0, 1.0)


TEXEL_MIDDLES = 0.5 * (texel_edges()[1:] + texel_edges()[:-1])
"""Where the texels of a strand lie on it, from 0 at the root to 1 at the tip."""


def _first_faces(scene: Scene) -> Int[np.ndarray, " segments"]:
    """The first of each segment's faces, among those of strands."""
    assert scene.strands is not None
    node = scene.strands.corners[0][:, 0]
    return np.flatnonzero(np.diff(node, prepend=-1))
