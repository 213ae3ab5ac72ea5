"""A lighting on the GPU: its emitters, their shadow views, and the environment maps that show behind the scene."""

from dataclasses import dataclass

import jax
import moderngl
import numpy as np

from prt_bench.emitters import Emitters
from prt_bench.lights import EnvironmentLight, Lighting, emitters, rotation_matrix
from prt_bench.runtime.projection import to_glsl
from prt_bench.runtime.views import ShadowViews, shadow_views


@dataclass(frozen=True, eq=False)
class UploadedLights:
    """Buffers of one lighting, laid out as in `emitters.glsl` and `views.glsl`, and each map with its rotation.

    `distant` says whether any emitter is infinitely far away.
    """

    emitters: moderngl.Buffer
    views: moderngl.Buffer
    view_count: int
    environments: tuple[tuple[moderngl.Texture, np.ndarray], ...]
    distant: bool

    def bind(self) -> None:
        """Bind both buffers where the shaders expect them."""
        self.emitters.bind_to_storage_buffer(0)
        self.views.bind_to_storage_buffer(1)


def upload(context: moderngl.Context, lighting: Lighting, bounds: np.ndarray, atlas_size: int) -> UploadedLights:
    """Upload one lighting. Emitters without intensity are dropped: darkness costs nothing."""
    lighting.check()
    batch = emitters([lighting])
    lit = np.flatnonzero(np.asarray(batch.intensity[0]).max(axis=1) > 0)
    chosen = jax.tree.map(lambda leaf: np.asarray(leaf[0])[lit], batch)
    views = shadow_views(chosen, bounds, atlas_size)
    maps = [light for light in lighting.lights if isinstance(light, EnvironmentLight)]
    return UploadedLights(
        context.buffer(_pack_emitters(chosen, views)),
        context.buffer(_pack_views(views)),
        len(views.matrix),
        tuple((_texture(context, light.map.radiance), np.asarray(rotation_matrix(light.rotation))) for light in maps),
        bool((chosen.position[:, 3] == 0).any()),
    )


def _pack_emitters(chosen: Emitters, views: ShadowViews) -> bytes:
    """`emitter_count`, padded to 16 bytes, then four vectors per emitter."""
    rows = np.concatenate(
        [
            chosen.position,
            np.column_stack([chosen.axis, views.first]),
            np.column_stack([chosen.intensity, views.count]),
            chosen.profile,
        ],
        axis=1,
    )
    return np.array([len(rows), 0, 0, 0], "<i4").tobytes() + rows.astype("<f4").tobytes()


def _pack_views(views: ShadowViews) -> bytes:
    """`tile_size`, padded to 16 bytes, then two matrices and a vector per view."""
    head = np.array([views.tile_size, 0, 0, 0], "<f4").tobytes()
    tiles = np.column_stack([views.corner, views.texel, np.zeros(len(views.texel))]).astype("<f4")
    return head + b"".join(
        to_glsl(matrix) + to_glsl(np.linalg.inv(matrix)) + tile.tobytes()
        for matrix, tile in zip(views.matrix, tiles, strict=True)
    )


def _texture(context: moderngl.Context, radiance: np.ndarray) -> moderngl.Texture:
    height, width = radiance.shape[:2]
    texture = context.texture((width, height), 3, np.ascontiguousarray(radiance, "<f4").tobytes(), dtype="f4")
    texture.repeat_y = False
    return texture
