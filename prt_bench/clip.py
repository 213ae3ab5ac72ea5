"""A clip: datasets of the keyframes of one animation, whose points keep their places on the moving surface.

Each keyframe has geometry, a traced operator and lightings of its own. Taken together they are one set of examples, which
any method can be fitted to that needs nothing but pairs of light; models for clips are in `animation.py`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from prt_bench.dataset import LightingDataset
from prt_bench.errors import DatasetError


@dataclass(frozen=True, eq=False)
class Clip:
    """Keyframes that share receivers [T] and measurement points [M]: same face and barycentrics, other positions.

    The arrays hold all keyframes' lightings one after another. Raises `DatasetError` for datasets of other points.
    """

    keyframes: tuple[LightingDataset, ...]

    def __post_init__(self) -> None:
        if not self.keyframes:
            raise DatasetError("a clip has at least one keyframe, but none was given")
        first = _places(self.keyframes[0])
        for index, ds in enumerate(self.keyframes):
            if not all(np.array_equal(a, b) for a, b in zip(first, _places(ds), strict=True)):
                raise DatasetError(
                    f"keyframe {index} ('{ds.scene.name}') has other points on its surface than keyframe 0; bake all keyframes"
                    " by one bake_animation, or with the first as layout"
                )

    def split(self, name: str) -> "Clip":
        """One split of every keyframe, "train" or "test"."""
        return Clip(tuple(ds.split(name) for ds in self.keyframes))

    @cached_property
    def measured(self) -> Float[np.ndarray, "N M C"]:
        """Direct irradiance at the measurement points, in W/m²."""
        return np.concatenate([ds.measured for ds in self.keyframes])

    @cached_property
    def indirect(self) -> Float[np.ndarray, "N T C"]:
        """Indirect irradiance at the receivers, in W/m²."""
        return np.concatenate([ds.indirect for ds in self.keyframes])

    @cached_property
    def indirect_half(self) -> Float[np.ndarray, "N T C"]:
        """Indirect irradiance from the first half of the rays alone; kept for held-out lightings only."""
        return np.concatenate([ds.indirect_half for ds in self.keyframes])

    @property
    def noise_floor(self) -> float:
        """Root mean square over the keyframes of their noise floors."""
        return float(np.sqrt(np.mean([ds.noise_floor**2 for ds in self.keyframes])))

    def __len__(self) -> int:
        return len(self.keyframes)

    def __getitem__(self, index: int) -> LightingDataset:
        return self.keyframes[index]

    def __iter__(self) -> Iterator[LightingDataset]:
        return iter(self.keyframes)


def _places(ds: LightingDataset) -> tuple[np.ndarray, ...]:
    points = (ds.points, ds.measurement_points, ds.dense_points)
    return (*(part for p in points for part in (p.face, p.barycentric)), ds.groups, ds.lightmap.texel)
