"""Environment maps: reading, checking, and their reduction to directional emitters by median cut."""

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Bool, Float

from prt_bench.errors import LightError

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear RGB in luminance (Rec. 709)."""
RINGING = 1e-5
"""Share of a map's energy below which negative radiance counts as ringing of its compression."""


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Equirectangular radiance [H, W, 3] in W/m²/sr, y up, −z at the image's centre. Compared by content."""

    name: str
    radiance: Float[np.ndarray, "H W 3"]

    def __post_init__(self) -> None:
        if self.radiance.ndim != 3 or self.radiance.shape[-1] != 3 or self.radiance.size == 0:
            raise LightError(
                f"environment '{self.name}' has shape {self.radiance.shape}, but must be [height, width, 3]"
            )
        bad = int(np.sum(_bad(self.radiance)))
        if bad:
            raise LightError(
                f"environment '{self.name}' has {bad} negative or non-finite values; EnvironmentMap.repaired mends them"
            )

    @classmethod
    def repaired(cls, name: str, radiance: Float[np.ndarray, "H W 3"]) -> tuple[Self, int]:
        """The map with its negative and non-finite values replaced, and how many there were.

        Negative ones and NaN become zero, infinite ones the largest finite value.
        """
        radiance = np.array(radiance, np.float32)
        bad = _bad(radiance)
        most = float(radiance[~bad].max(initial=0.0))
        radiance[bad] = np.where(np.isposinf(radiance[bad]), most, 0.0)
        return cls(name, radiance), int(bad.sum())

    @classmethod
    def coerce(cls, source: "EnvironmentMap | str | Path | np.ndarray") -> "EnvironmentMap":
        """Accept a map, a path to an EXR file, or an array of radiance."""
        if isinstance(source, EnvironmentMap):
            return source
        if isinstance(source, (str, Path)):
            return cls.read(Path(source))
        return cls("array", np.asarray(source, np.float32))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the RGB channels of an EXR file. Raises `LightError` when it is missing or holds no RGB.

        Negative values left by lossy compression, under `RINGING` of the map's energy, become zero.
        """
        import OpenEXR

        if not path.is_file():
            raise LightError(f"environment map {path} does not exist")
        try:
            with OpenEXR.File(str(path)) as file:
                channels = file.channels()
                pixels = channels["RGB"].pixels if "RGB" in channels else channels["RGBA"].pixels[..., :3]
        except (KeyError, RuntimeError, ValueError) as error:
            raise LightError(f"environment map {path} is not a readable RGB EXR file ({error})") from error
        radiance = np.array(pixels, np.float32)
        if -radiance[radiance < 0].sum() <= RINGING * radiance.sum():
            radiance = np.maximum(radiance, 0.0)
        return cls(path.stem, radiance)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the radiance."""
        return hashlib.sha256(np.ascontiguousarray(self.radiance, "<f4").tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EnvironmentMap) and self.hash == other.hash

    def __hash__(self) -> int:
        return hash(self.hash)


def _bad(radiance: np.ndarray) -> Bool[np.ndarray, "H W 3"]:
    """Values that are no radiance."""
    return ~np.isfinite(radiance) | (radiance < 0)


def texel_directions(height: int, width: int) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H 1"]]:
    """Unit direction of every texel centre and the exact solid angle of a texel in each row."""
    edges = np.linspace(0.0, np.pi, height + 1)
    theta = 0.5 * (edges[1:] + edges[:-1])[:, None]
    phi = ((np.arange(width) + 0.5) / width * 2.0 - 1.0)[None, :] * np.pi
    direction = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi), -np.sin(theta) * np.cos(phi)], axis=-1
    )
    solid_angle = (np.cos(edges[:-1]) - np.cos(edges[1:]))[:, None] * (2.0 * np.pi / width)
    return direction, solid_angle


@lru_cache(maxsize=64)
def median_cut(environment: EnvironmentMap, count: int) -> tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, "Q 3"]]:
    """Split the map into `count` regions of near-equal energy; each becomes one direction.

    Returns unit directions towards the light [Q, 3] and irradiance at normal incidence [Q, 3], so that their product is
    the region's vector irradiance ∫ L ω dω: exact for every surface that sees the whole region (grey maps; for others the
    direction is that of the luminance). `count` must be a power of two.
    """
    direction, solid_angle = texel_directions(*environment.radiance.shape[:2])
    energy = environment.radiance.astype(float) * solid_angle[..., None]
    luminance = energy @ LUMINANCE
    regions = [(0, luminance.shape[0], 0, luminance.shape[1])]
    while len(regions) < count:
        regions = [half for region in regions for half in _halves(luminance, region)]
    directions, irradiances = [], []
    for top, bottom, left, right in regions:
        weight = luminance[top:bottom, left:right, None]
        mean = np.sum(direction[top:bottom, left:right] * weight, axis=(0, 1))
        centre = direction[(top + bottom - 1) // 2, (left + right - 1) // 2]
        norm = np.linalg.norm(mean)
        directions.append(mean / norm if norm > 0 else centre)
        total = luminance[top:bottom, left:right].sum()
        irradiances.append(energy[top:bottom, left:right].sum(axis=(0, 1)) * (norm / total if total > 0 else 0.0))
    return np.array(directions), np.array(irradiances)


def _halves(luminance: np.ndarray, region: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
    """Cut a region across its longer side, measured on the sphere, where the energy halves."""
    top, bottom, left, right = region
    block = luminance[top:bottom, left:right]
    mid = np.pi * (top + bottom) / 2 / luminance.shape[0]
    tall = (bottom - top) / luminance.shape[0] >= 2.0 * (right - left) / luminance.shape[1] * np.sin(mid)
    size = bottom - top if tall else right - left
    if size < 2:
        tall, size = not tall, (right - left if tall else bottom - top)
    if size < 2:
        return [region, (top, top, left, left)]
    profile = np.cumsum(block.sum(axis=1 if tall else 0))
    cut = int(np.clip(np.searchsorted(profile, profile[-1] / 2) + 1, 1, size - 1))
    if tall:
        return [(top, top + cut, left, right), (top + cut, bottom, left, right)]
    return [(top, bottom, left, left + cut), (top, bottom, left + cut, right)]
