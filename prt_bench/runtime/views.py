"""Shadow views of a lighting: which cameras see what its emitters light, and where each goes in the depth atlas.

Arithmetic only; `shadow.py` draws them and `shaders/shadow.glsl` looks them up.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prt_bench.emitters import Emitters
from prt_bench.errors import LightError
from prt_bench.runtime.projection import any_up, corners, distance_to_box, look_along, orthographic, perspective

NARROW = 0.5
"""Cosine of the widest cone (60°) that one perspective view covers; wider ones take the six faces of a cube."""
GUARD = 2
"""Texels around each tile that let a lookup near its edge find depth."""
SMALLEST_TILE = 16
_CUBE = np.concatenate([[row, -row] for row in np.eye(3)])  # +x −x +y −y +z −z, as in shadow.glsl


@dataclass(frozen=True)
class ShadowViews:
    """V views in square tiles of `tile_size` texels.

    matrix [V, 4, 4]: world to the tile's clip space; corner [V, 2]: first texel of the tile; texel [V]: world size of a
    texel per unit of clip w; first and count [Q]: each emitter's views.
    """

    matrix: Float[np.ndarray, "V 4 4"]
    corner: Int[np.ndarray, "V 2"]
    texel: Float[np.ndarray, " V"]
    first: Int[np.ndarray, " Q"]
    count: Int[np.ndarray, " Q"]
    tile_size: int


def shadow_views(emitters: Emitters, bounds: Float[np.ndarray, "2 3"], atlas_size: int) -> ShadowViews:
    """Share the atlas evenly among the views of all emitters; bounds are those of the scene, in metres.

    Raises `LightError` when there are so many that tiles would fall below `SMALLEST_TILE` texels.
    """
    position, profile = np.asarray(emitters.position, float), np.asarray(emitters.profile, float)
    omnidirectional = (position[:, 3] > 0) & (profile[:, 0] < NARROW)
    count = np.where(omnidirectional, 6, 1)
    total = int(count.sum())
    side = max(int(np.ceil(np.sqrt(total))), 1)
    tile = atlas_size // side
    if tile < SMALLEST_TILE:
        raise LightError(
            f"{len(count)} emitters need {total} shadow views, too many for a shadow atlas of {atlas_size}² texels;"
            " use fewer lights or raise shadow_resolution"
        )
    shrink = 1.0 - 2.0 * GUARD / tile
    matrices = []
    for q, is_cube in enumerate(omnidirectional):
        if position[q, 3] == 0:
            matrices.append(_parallel(position[q, :3], bounds, shrink))
        elif is_cube:
            matrices += [_cone(position[q, :3], face, 1.0, bounds, shrink) for face in _CUBE]
        else:
            tangent = np.tan(np.arccos(profile[q, 0]))
            matrices.append(_cone(position[q, :3], np.asarray(emitters.axis[q], float), tangent, bounds, shrink))
    matrix = np.array(matrices).reshape(-1, 4, 4)
    index = np.arange(total)
    scale = np.linalg.norm(matrix[:, :2, :3], axis=2).min(axis=1, initial=np.inf)
    return ShadowViews(
        matrix=matrix,
        corner=np.stack([index % side, index // side], axis=1) * tile,
        texel=2.0 / (scale * tile),
        first=np.cumsum(count) - count,
        count=count,
        tile_size=tile,
    )


def _parallel(towards_light: np.ndarray, bounds: np.ndarray, shrink: float) -> np.ndarray:
    """Orthographic view along parallel light, fitted to the scene."""
    view = look_along(np.zeros(3), -towards_light, any_up(towards_light))
    seen = corners(bounds) @ view[:3, :3].T
    margin = 1e-3 * np.linalg.norm(bounds[1] - bounds[0])
    clip = orthographic(seen.min(axis=0) - margin, seen.max(axis=0) + margin) @ view
    return np.diag([shrink, shrink, 1.0, 1.0]) @ clip


def _cone(eye: np.ndarray, axis: np.ndarray, tangent: float, bounds: np.ndarray, shrink: float) -> np.ndarray:
    """Perspective view of the square cone with the given tangent of its half-angle."""
    near = max(1e-3 * float(np.linalg.norm(bounds[1] - bounds[0])), 0.5 * distance_to_box(eye, bounds))
    far = 1.01 * float(np.linalg.norm(corners(bounds) - eye, axis=1).max())
    return perspective(shrink / tangent, shrink / tangent, near, far) @ look_along(eye, axis, any_up(axis))
