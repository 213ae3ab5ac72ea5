"""Samples on surfaces: where light is received, measured and gathered."""

from typing import Self

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int


class SurfacePoints(eqx.Module):
    """Points on a scene's surface, with what transport needs to know of them.

    position [P, 3] in metres, unit normal [P, 3], albedo [P, 3] (linear RGB), and where each point lies on the mesh:
    face [P] and barycentric [P, 3]. NumPy arrays; points are data, not parameters, so nothing is differentiated here
    (albedo enters the transport as an explicit argument).

    `clearance` [P], None where no point lies on hair, is above zero at points on the axis of a strand: the distance from there
    that is outside of its tube, in metres. Their `normal` is the unit tangent of the strand, and irradiance on them the mean
    over the circumference.
    """

    position: Float[np.ndarray, "P 3"]
    normal: Float[np.ndarray, "P 3"]
    albedo: Float[np.ndarray, "P 3"]
    face: Int[np.ndarray, " P"]
    barycentric: Float[np.ndarray, "P 3"]
    clearance: Float[np.ndarray, " P"] | None = None

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: slice | np.ndarray) -> Self:
        return type(self)(
            self.position[index],
            self.normal[index],
            self.albedo[index],
            self.face[index],
            self.barycentric[index],
            None if self.clearance is None else self.clearance[index],
        )


class Lightmap(eqx.Module):
    """The square image whose covered texels are the receivers.

    `resolution` is the side in texels, `texel` [T] the flat index (row · resolution + column, row 0 at v = 0) of each
    receiver, `corner_uv` [F, 3, 2] the lightmap coordinates of every face corner in [0, 1], `chart` [F] the atlas chart
    each face belongs to. Charts are so far apart that images can be halved `mips` times, each time averaging four texels,
    without light of one chart reaching another's lookups.
    """

    resolution: int
    texel: Int[np.ndarray, " T"]
    corner_uv: Float[np.ndarray, "F 3 2"]
    chart: Int[np.ndarray, " F"]
    mips: int = 0

    def image(self, values: Float[np.ndarray, "T C"], fill: float = 0.0) -> Float[np.ndarray, "H W C"]:
        """Scatter receiver values into the lightmap; uncovered texels hold `fill`."""
        values = np.asarray(values)
        out = np.full((self.resolution * self.resolution, values.shape[-1]), fill, values.dtype)
        out[self.texel] = values
        return out.reshape(self.resolution, self.resolution, -1)
