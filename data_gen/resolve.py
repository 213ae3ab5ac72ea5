"""From a ray's hit to the gather sample it carries light from, never in another chart than the one that was hit.

One fused kernel, because this runs once per traced ray: it costs a tenth of the intersection itself.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from data_gen.atlas import PADDING
from prt_bench.hemisphere import ONE_THREAD
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Mesh

_NO_CHART = -2.0


@dataclass(frozen=True)
class HitResolver:
    """Tables on the CPU device. Texels have a border of one, so that a jittered place never leaves the table.

    `face`: ten arrays [F]: texel coordinates of a face's first corner (2), the edges from there to the others (4), its chart
    and its normal (3). Ten arrays, because lookups of single numbers vectorise where lookups of rows do not; and a lookup of
    the normal costs less than a copy of the one embree returns.
    `sample` [(res + 2)²]: the texel's sample, or the nearest one within the padding, in the smallest type that holds them
    all; `chart` [(res + 2)²]: that sample's.
    """

    samples: int
    width: int
    face: tuple[Float[Array, " F"], ...]
    sample: Int[Array, " texels"] | UInt[Array, " texels"]
    chart: Float[Array, " texels"]

    @classmethod
    def create(
        cls, mesh: Mesh, lightmap: Lightmap, points: SurfacePoints, buried: Bool[np.ndarray, " S"] | None = None
    ) -> "HitResolver":
        """Tables for hits on `mesh`, which `lightmap` unwraps; `points` are its covered texels.

        Where another body stands on a texel its point may be `buried` in it, and dark, while the rest of the texel is lit:
        a hit there goes to the nearest sample of the chart that is not.
        """
        side, samples = lightmap.resolution, np.arange(len(points), dtype=np.int32)
        if buried is not None and buried.any() and not buried.all():
            apart = 4 * side * lightmap.chart[points.face]
            place = np.stack([lightmap.texel % side, lightmap.texel // side, apart], axis=1)
            _, nearest = KDTree(place[~buried]).query(place[buried])
            samples[buried] = samples[~buried][nearest]
        home = np.append(lightmap.chart[points.face], _NO_CHART)
        samples[home[samples] != home[:-1]] = len(points)  # the whole chart is buried
        covered = np.full((side + 2, side + 2), -1, np.int32)
        covered[1:-1, 1:-1].flat[lightmap.texel] = samples
        empty = covered < 0
        row, column = np.asarray(distance_transform_edt(empty, return_distances=False, return_indices=True))
        distance = np.asarray(distance_transform_edt(empty))
        sample = np.where(distance < PADDING, covered[row, column], len(points))
        uv = lightmap.corner_uv * side
        edges = (uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0])
        columns = np.column_stack([uv[:, 0] + 1.0, *edges, lightmap.chart, mesh.normals])
        chart = home.astype(np.float32)[sample]
        on_cpu = partial(jax.device_put, device=jax.devices("cpu")[0])
        face = tuple(on_cpu(column) for column in columns.T.astype(np.float32))
        index = np.uint16 if len(points) + 1 < 2**16 else np.int32
        return cls(len(points), side + 2, face, on_cpu(sample.ravel().astype(index)), on_cpu(chart.ravel()))

    @property
    def normals(self) -> Float[np.ndarray, "F 3"]:
        """The faces' own normals."""
        return np.stack([np.asarray(column) for column in self.face[-3:]], axis=1)

    def __call__(
        self,
        found: dict[str, np.ndarray],
        directions: Float[Array, "P*R 3"],
        jitter: tuple[Float[Array, "sets R"], Float[Array, "sets R"]],
        chosen: Int[np.ndarray, " P"],
    ) -> Int[np.ndarray, " P*R"] | UInt[np.ndarray, " P*R"]:
        """Sample index of each of embree's answers `found`, in the type of `sample`; `samples` for a ray that carries nothing,
        as it met the back of a one-sided surface or a face without texels, and `samples` + 1 for one that escaped.

        `jitter[chosen]`, in texels from −½ to ½, is added to the place looked up, except where it would leave the chart:
        the texel that was hit is always one of the chart's own.
        """
        hits = (found["primID"], found["u"], found["v"], directions, jitter, chosen)
        return np.asarray(_resolve(*hits, self.face, self.sample, self.chart, width=self.width, nothing=self.samples))


@partial(jax.jit, static_argnames=("width", "nothing"), compiler_options=ONE_THREAD)
def _resolve(
    face: Any, u: Any, v: Any, direction: Array, jitter: tuple[Array, Array], chosen: Any,
    faces: tuple[Array, ...], sample: Array, chart: Array, *, width: int, nothing: int,
) -> Array:  # fmt: skip
    s0, t0, s1, t1, s2, t2, home, x, y, z = (column.at[face].get(mode="clip") for column in faces)
    s = s0 + u * s1 + v * s2
    t = t0 + u * t1 + v * t2
    facing = x * direction[:, 0] + y * direction[:, 1] + z * direction[:, 2]
    s_jitter, t_jitter = (offsets.at[chosen].get(mode="clip").ravel() for offsets in jitter)

    def texel(s: Array, t: Array) -> Array:
        return t.astype(jnp.int32) * width + s.astype(jnp.int32)

    place = texel(s + s_jitter, t + t_jitter)
    place = jnp.where(chart.at[place].get(mode="clip") == home, place, texel(s, t))
    carries = (face >= 0) & (facing < 0) & (home >= 0)
    without = jnp.where(face < 0, jnp.asarray(nothing + 1, sample.dtype), jnp.asarray(nothing, sample.dtype))
    return jnp.where(carries, sample.at[place].get(mode="clip"), without)
