"""Scenes without meshes: parts of signed distance, each with its material, and surface samples with transfer vectors.

Following rays through them is in `tracing.py`; built-in scenes and sampling are in `data_gen`.
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from prt_bench.errors import SceneError
from prt_bench.implicit.expression import Distance, in_few_sizes, normals
from prt_bench.implicit.operations import Union
from prt_bench.scene import Camera, Glossy, Material

HIT = 2.0**-14
"""A ray has hit where |d| is below this share of the scene's extent."""
OFFSET = 4.0
"""Rays leave surfaces this many times as far above them: no ray meets the point that it left."""


class Part(NamedTuple):
    """A shape and what it is made of; images are refused, since a place in space has no texture coordinates."""

    shape: Distance
    material: Material


@dataclass(frozen=True, eq=False)
class ImplicitScene:
    """Parts that are all there together; a point of the surface is of the part that is nearest.

    `box` [2, 3] cuts everything off outside, and is the parts' own unless given. Raises `SceneError` for no parts, parts
    without bounds, and images.
    """

    name: str
    parts: tuple[Part, ...]
    camera: Camera
    box: Float[np.ndarray, "2 3"] | None = None

    def __post_init__(self) -> None:
        if not self.parts:
            raise SceneError(f"the implicit scene '{self.name}' has no parts; give it at least one")
        for part in self.parts:
            lobe = part.material.glossy
            images = (part.material.image, part.material.normal_image, lobe and lobe.roughness_image)
            if any(image is not None for image in images):
                raise SceneError(
                    f"material '{part.material.name}' of '{self.name}' has an image, but an implicit surface has no"
                    " texture coordinates; give it one colour"
                )
        if not np.all(np.isfinite(self.bounds)) or np.any(self.bounds[1] <= self.bounds[0]):
            raise SceneError(
                f"the implicit scene '{self.name}' has no finite, non-empty bounds; give it a box, or intersect planes and"
                " gyroids with one"
            )

    @cached_property
    def shape(self) -> Distance:
        """The union of all parts."""
        return reduce(Union, (part.shape for part in self.parts))

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Corners of the box that holds the surface, in metres."""
        if self.box is not None:
            return np.asarray(self.box, float)
        return np.stack(
            [
                np.min([part.shape.bounds[0] for part in self.parts], axis=0),
                np.max([part.shape.bounds[1] for part in self.parts], axis=0),
            ]
        )

    @property
    def extent(self) -> float:
        """Length of the box's diagonal, in metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def tolerance(self) -> float:
        """|d| at which a ray has hit, in metres: relative to the largest coordinate too, which float32 resolves."""
        return HIT * max(self.extent, float(np.abs(self.bounds).max()))

    @property
    def achromatic(self) -> bool:
        """Whether every part reflects all channels alike."""
        return all(len(set(part.material.albedo)) == 1 for part in self.parts)

    @property
    def glossy(self) -> bool:
        """Whether any material has a lobe."""
        return any(part.material.glossy is not None for part in self.parts)

    @property
    def albedos(self) -> Float[np.ndarray, "parts 3"]:
        """Diffuse albedo of every part, linear RGB."""
        return np.array([part.material.albedo for part in self.parts], float)

    @property
    def lobes(self) -> Float[np.ndarray, "parts 4"]:
        """Specular reflectance and exponent of every part; 0 where there is no lobe."""
        found = [part.material.glossy or Glossy((0.0, 0.0, 0.0), 0.0) for part in self.parts]
        return np.array([(*lobe.specular, lobe.exponent) for lobe in found], float)

    def part_at(self, position: Float[np.ndarray, "P 3"]) -> Int[np.ndarray, " P"]:
        """The part that each point belongs to."""
        return in_few_sizes(_nearest, tuple(part.shape for part in self.parts), np.asarray(position))

    def normal_at(self, position: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Unit normals out of the surface; see `expression.normals`."""
        return normals(self.shape, np.asarray(position), self.tolerance)


@eqx.filter_jit
def _nearest(shapes: tuple[Distance, ...], position: Float[Array, "P 3"]) -> Int[Array, " P"]:
    return jnp.argmin(jnp.stack([shape(position) for shape in shapes]), axis=0)


class SurfaceSamples(NamedTuple):
    """P points on the zero set, uniform by area: where they are and what they receive.

    position and unit normal [P, 3], albedo [P, 3] (linear RGB). `direct` [P, K] and `indirect` [P, W, K] are transfer
    vectors in steradians, the second of all bounces, with W = 1 for grey scenes or 3. NumPy arrays: points are data.
    """

    position: Float[np.ndarray, "P 3"]
    normal: Float[np.ndarray, "P 3"]
    albedo: Float[np.ndarray, "P 3"]
    direct: Float[np.ndarray, "P K"]
    indirect: Float[np.ndarray, "P W K"]

    @property
    def vectors(self) -> Float[np.ndarray, "P W1 K"]:
        """As `TripleModel` has them: transfer of all light for each channel, then that of direct light for the lobes."""
        return np.concatenate([self.direct[:, None] + self.indirect, self.direct[:, None]], axis=1)

    def __len__(self) -> int:
        return len(self.position)
