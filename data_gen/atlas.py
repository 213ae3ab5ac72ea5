"""Lightmaps: the atlas that unwraps a scene, and the surface point of every texel.

Charts come from xatlas, or from the scene's own texture coordinates where those are a valid atlas. A texel is covered
when its square overlaps a triangle, so every chart has receivers and a hit always finds one.
"""

import logging
from importlib.metadata import version
from io import BytesIO
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from data_gen.charts import Charted, ChartsFailed, generate
from data_gen.journal import content_key, write_whole
from data_gen.raster import overlaps, rasterise
from prt_bench.errors import SceneError, SpecError
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Scene

PADDING = 2
"""Empty texels between charts at least: room for lookups half a texel off a chart, on either side."""
MOST_MIPS = 4
_FIT_STEPS = 12
_NO_CHART = -1
_VERSION = 1  # raise when the same scene would be cut into other charts
_log = logging.getLogger(__name__)


def unwrap(
    scene: Scene, resolution: int, folder: Path | None = None, mips: int = 0, texture_set: bool = False
) -> Lightmap:
    """The lightmap of a scene, `resolution` texels on a side; the same every time.

    Charts do not depend on the resolution, and cutting 75,000 triangles into them takes a minute: `folder` keeps them.

    The scene's texture coordinates are used when they lie in [0, 1], no face is degenerate in them, and no texel is
    shared by two charts or overlapping faces; otherwise xatlas makes charts and packs them as large as fits. The log
    (INFO) says which. Faces that no chart can hold belong to chart −1.

    `mips` halvings of the image leave charts apart (`padding`). In a `texture_set` every material has a square of its own,
    all of one size, in which its charts are as large as fits: small objects get as many texels as large ones. Either makes
    xatlas pack the charts. Raises `SceneError` when the charts do not fit, `SpecError` when the image cannot be halved so
    often.
    """
    if resolution < 4:
        raise SceneError(f"a lightmap of {resolution} texels a side is too small; use at least 4")
    check_mips(resolution, mips)
    flaw = "that was asked for" if mips or texture_set else _flaw_of_own_atlas(scene, resolution)
    if flaw is None:
        corner_uv, chart = np.asarray(scene.mesh.uv, float), _components(scene)
        _log.info("%s: keeps its own texture coordinates as atlas", scene.name)
    else:
        charts = _charts(scene, folder)
        corner_uv, chart = (_pack_set if texture_set else _pack)(*charts, scene, resolution, mips)
        _log.info("%s: unwrapped into %d charts, because %s", scene.name, chart.max() + 1, flaw)
    lost = int(np.sum(chart == _NO_CHART))
    if lost:
        _log.warning("%s: %d faces of zero area in the atlas receive no light", scene.name, lost)
    texel, _, _ = rasterise(corner_uv, chart >= 0, resolution)
    return Lightmap(resolution, texel, corner_uv, chart, mips)


def check_mips(resolution: int, mips: int) -> None:
    """Raise `SpecError` unless a lightmap of this many texels a side can be halved so often."""
    if not 0 <= mips <= MOST_MIPS or resolution % 2**mips:
        raise SpecError(
            f"{mips} mip levels were asked for, but a lightmap of {resolution}² texels can have from 0 to"
            f" {min(MOST_MIPS, (resolution & -resolution).bit_length() - 1)}"
        )


def padding(mips: int) -> int:
    """Empty texels between charts that `mips` halvings of the image need.

    In an image halved L times, a lookup on a chart reads at most one texel beyond the one that the chart ends in. They are
    2^L texels wide, so they hold up to 2 · 2^L − 1 texels beyond the chart, on either side.
    """
    return 2 ** (mips + 2) - 2


def lightmap_points(scene: Scene, lightmap: Lightmap) -> SurfacePoints:
    """The surface point of each receiver, in the order of `lightmap.texel`.

    It is the point at the texel's centre, or, where a triangle only overlaps the texel's edge, the point of that
    triangle nearest to the centre, drawn in from the border by a fraction of a texel so that no point lies in a crease.
    """
    texel, face, barycentric = rasterise(lightmap.corner_uv, lightmap.chart >= 0, lightmap.resolution)
    if not np.array_equal(texel, lightmap.texel):
        raise SceneError(f"the lightmap was not made for scene '{scene.name}'; unwrap the scene again")
    return surface_points(scene, face, barycentric)


def surface_points(scene: Scene, face: Int[np.ndarray, " P"], barycentric: Float[np.ndarray, "P 3"]) -> SurfacePoints:
    """Points given by face and barycentric coordinates, with their albedo and normals, tilted where a normal image says so."""
    position = np.einsum("pc,pcd->pd", barycentric, scene.mesh.triangles[face])
    normal = scene.shading_normal_at(face, barycentric)
    return SurfacePoints(position, normal, scene.albedo_at(face, barycentric), face, barycentric)


def _flaw_of_own_atlas(scene: Scene, resolution: int) -> str | None:
    """Why the scene's texture coordinates cannot serve as lightmap, or None when they can."""
    uv = scene.mesh.uv
    if uv is None:
        return "it has no texture coordinates"
    if not (np.all(np.isfinite(uv)) and uv.min() >= 0 and uv.max() <= 1):
        return "its texture coordinates leave [0, 1]"
    edge_a, edge_b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    if np.any(np.abs(edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]) * resolution**2 < 1e-6):
        return "some faces have no area in texture space"
    if overlaps(uv, _components(scene), resolution):
        return f"its texture coordinates overlap at {resolution}² texels"
    return None


def _components(scene: Scene) -> Int[np.ndarray, " F"]:
    """Charts of the scene's own coordinates: faces joined over edges that coincide in space and in texture."""
    corners = np.concatenate([scene.mesh.triangles, np.asarray(scene.mesh.uv)], axis=2).reshape(-1, 5)
    _, corner = np.unique(corners, axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    edges = np.sort(np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    face = np.repeat(np.arange(len(corner)), 3)
    incidence = coo_array((np.ones(len(face), bool), (face, edge.reshape(-1)))).tocsr()
    return connected_components(incidence @ incidence.T, directed=False)[1]


def _charts(scene: Scene, folder: Path | None) -> tuple[Float[np.ndarray, "F 3 2"], Int[np.ndarray, " F"]]:
    """What `_parametrise` gives, from `folder` where an earlier call left it."""
    if folder is None:
        return _parametrise(scene)
    about = {"version": _VERSION, "xatlas": version("xatlas"), "scene": scene.hash}
    path = folder / f"charts-{scene.name}-{content_key(about)}.npz"
    if not path.is_file():
        corner_uv, held = _parametrise(scene)
        content = BytesIO()
        np.savez(content, corner_uv=corner_uv, held=held)
        write_whole(path, content.getvalue())
    with np.load(path) as kept:
        return kept["corner_uv"], kept["held"]


def _parametrise(scene: Scene) -> tuple[Float[np.ndarray, "F 3 2"], Int[np.ndarray, " F"]]:
    """Charts by xatlas, in metres, side by side, and which faces have one. No chart spans two materials."""
    mesh = scene.mesh
    groups = [np.flatnonzero(mesh.material == index) for index in np.unique(mesh.material)]
    atlas = _by_xatlas(scene, [(mesh.vertices, mesh.faces[group]) for group in groups], padding=1)
    corner_uv = np.zeros((len(mesh.faces), 3, 2))
    held = np.zeros(len(mesh.faces), bool)
    for group, (faces, uv, sheet, _) in zip(groups, atlas.sheets, strict=True):
        corner_uv[group] = (uv * atlas.size / atlas.texels_per_unit)[faces]
        held[group] = (sheet[faces] >= 0).all(axis=1)
    return corner_uv, held


def _pack_set(
    corner_uv: Float[np.ndarray, "F 3 2"], held: np.ndarray, scene: Scene, resolution: int, mips: int
) -> tuple[Float[np.ndarray, "F 3 2"], Int[np.ndarray, " F"]]:
    """Charts of each material packed into a square of its own; the squares lie in rows."""
    owner = scene.mesh.material
    objects = np.unique(owner[held])
    across = ceil(sqrt(len(objects)))
    side = resolution // across
    margin = padding(mips) // 2  # charts may touch the borders of what they are packed into
    inside = side - 2 * margin
    if inside < 4:
        raise SceneError(
            f"'{scene.name}' has {len(objects)} materials, and squares of {side}² texels leave them none between"
            f" margins of {margin}; ask for more texels" + f", or fewer mip levels than {mips}" * (mips > 0)
        )
    out_uv, out_chart, charts = np.zeros_like(corner_uv), np.full(len(corner_uv), _NO_CHART, np.int32), 0
    for place, index in enumerate(objects):
        mine = held & (owner == index)
        uv, chart = _pack(corner_uv, mine, scene, inside, mips)
        row, column = divmod(place, across)
        corner = np.array([column, row]) * side + margin
        out_uv[mine] = (uv[mine] * inside + corner) / resolution
        out_chart[mine] = chart[mine] + charts
        charts += chart.max() + 1
    return out_uv, out_chart


def _pack(
    corner_uv: Float[np.ndarray, "F 3 2"], held: np.ndarray, scene: Scene, resolution: int, mips: int
) -> tuple[Float[np.ndarray, "F 3 2"], Int[np.ndarray, " F"]]:
    """Place charts into the unit square at the largest common scale that fits, by bisection over texels per metre."""
    flat = corner_uv[held].reshape(-1, 2)
    vertices, faces = np.unique(flat.astype(np.float32), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.uint32)
    side = np.sqrt(_areas(corner_uv[held]).sum())
    low, high, best = np.log(0.05 * resolution / side), np.log(resolution / side), None
    for _ in range(_FIT_STEPS):
        density = np.exp(low if best is None else 0.5 * (low + high))
        packed = _try_packing(scene, vertices, faces, resolution, density, padding(mips))
        if packed is not None:
            best, low = packed, np.log(density)
        elif best is None:
            break
        else:
            high = np.log(density)
    if best is None:
        raise SceneError(
            f"the charts of '{scene.name}' do not fit {resolution}² texels; ask for more texels"
            + f", or fewer mip levels than {mips}" * (mips > 0)
        )
    out_uv, out_chart = np.zeros_like(corner_uv), np.full(len(corner_uv), _NO_CHART, np.int32)
    out_uv[held], out_chart[held] = best
    return out_uv, out_chart


def _try_packing(
    scene: Scene, vertices: np.ndarray, faces: np.ndarray, resolution: int, density: float, apart: int
) -> tuple[Float[np.ndarray, "F 3 2"], Int[np.ndarray, " F"]] | None:
    """Coordinates and chart of every face when all charts fit one square at this density, else None."""
    atlas = _by_xatlas(
        scene, [(vertices, faces)], unwrapped=True, resolution=resolution, texels_per_unit=density,
        padding=apart // 2,  # xatlas pads every chart on all sides
        bruteForce=resolution <= 512,  # slow on larger squares, and gains nothing there
    )  # fmt: skip
    if atlas.count != 1:
        return None
    placed, uv, _, chart = atlas.sheets[0]
    corner_uv = uv.astype(float)[placed]
    # xatlas shrinks a chart that is larger than the square; all charts are to have one scale.
    scale = _areas(corner_uv).sum() * resolution**2 / (_areas(vertices[faces].astype(float)).sum() * density**2)
    if scale < 0.97:
        return None
    return corner_uv, chart[placed[:, 0]]


def _by_xatlas(
    scene: Scene, meshes: list[tuple[np.ndarray, np.ndarray]], unwrapped: bool = False, **options: float | bool
) -> Charted:
    """`charts.generate` for a scene. Raises `SceneError` where that fails."""
    try:
        return generate(meshes, unwrapped, **options)
    except ChartsFailed as reason:
        raise SceneError(
            f"'{scene.name}' was not unwrapped: {reason}; try again, or give it texture coordinates of its own"
        ) from reason


def _areas(corners: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, " F"]:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
