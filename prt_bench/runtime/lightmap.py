"""Lightmap textures: receiver values packed four columns to an RGBA layer, and extended beyond the charts' borders."""

import moderngl
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from prt_bench.errors import AssetError
from prt_bench.points import Lightmap


class LightmapLayout:
    """Which receiver fills each texel: its own or the nearest, so that bilinear lookups never meet an empty texel."""

    def __init__(self, context: moderngl.Context, lightmap: Lightmap, buried: Bool[np.ndarray, " T"]) -> None:
        self._context = context
        self.resolution = lightmap.resolution
        self.receivers = len(lightmap.texel)
        self.mips = lightmap.mips
        self.texels = lightmap.texel
        self._source = nearest_receiver(lightmap, buried)

    def upload(self, columns: Float[np.ndarray, "T B"]) -> moderngl.TextureArray:
        """Columns as layers of four, in their own precision (float32 or float16)."""
        layers = -(-columns.shape[1] // 4)
        most = self._context.info["GL_MAX_ARRAY_TEXTURE_LAYERS"]
        if layers > most:
            raise AssetError(f"{columns.shape[1]} basis functions need {layers} texture layers; this GPU has {most}")
        texture = self._context.texture_array(
            (self.resolution, self.resolution, layers), 4, dtype="f2" if columns.dtype == np.float16 else "f4"
        )
        texture.repeat_x = texture.repeat_y = False
        block = np.zeros((self.resolution**2, 4), columns.dtype)
        for layer in range(layers):
            part = columns[:, 4 * layer : 4 * layer + 4]
            block[:, : part.shape[1]] = part[self._source]
            block[:, part.shape[1] :] = 0
            texture.write(block.tobytes(), viewport=(0, 0, layer, self.resolution, self.resolution, 1))
        if self.mips:
            texture.build_mipmaps(max_level=self.mips)
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return texture


def nearest_receiver(lightmap: Lightmap, buried: Bool[np.ndarray, " T"]) -> Int[np.ndarray, " texels"]:
    """For each texel of the image, row by row, the receiver in it or the nearest one that another body does not stand on."""
    side = lightmap.resolution
    owner = np.full(side * side, -1)
    receivers = np.arange(len(lightmap.texel))
    owner[lightmap.texel] = receivers if buried.all() else np.where(buried, -1, receivers)
    empty = owner.reshape(side, side) < 0
    rows, columns = np.asarray(distance_transform_edt(empty, return_distances=False, return_indices=True))
    return owner[rows * side + columns].ravel()
