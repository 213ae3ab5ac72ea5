"""What light meets inside a translucent body: a homogeneous scattering medium behind a smooth boundary.

Its parameters, and what its boundary lets through. Walks in it are followed in `data_gen/effects/subsurface.py`, and their
use as a linear map is `prt_bench.transport.Scattering`.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from prt_bench.errors import SceneError

GREATEST_IOR = 3.0
_NODES = 256  # of the quadrature over angles: the average is right to 1e-6

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Subsurface:
    """A homogeneous medium that fills the closed surfaces of a material.

    `scattering` and `absorption` are coefficients per metre for red, green and blue, whose sum is above zero; `anisotropy` is
    the mean cosine g of the Henyey–Greenstein phase function, from −1 to 1 exclusive; `ior` is the index of refraction
    relative to the outside, from 1 (a matched boundary, which reflects nothing) to `GREATEST_IOR`.

    Light enters and leaves through a smooth dielectric boundary by Fresnel's equations for unpolarised light. What arrives
    from outside is taken to be diffuse, and what leaves is stored as if it were: that is the radiosity of the rest of the
    transport. What the boundary reflects outside is the material's own `albedo` and `glossy`, and is black without them.
    """

    scattering: Triple = (1000.0, 1000.0, 1000.0)
    absorption: Triple = (1.0, 1.0, 1.0)
    anisotropy: float = 0.0
    ior: float = 1.3

    def __post_init__(self) -> None:
        for name in ("scattering", "absorption"):
            values = np.asarray(getattr(self, name), float)
            if values.shape != (3,) or not np.all((values >= 0) & np.isfinite(values)):
                raise SceneError(
                    f"a medium has {name} {getattr(self, name)}, but it must be three numbers per metre from 0 up"
                )
        if not np.all(self.extinction > 0):
            raise SceneError("a medium neither scatters nor absorbs in some channel; give it either, or leave it out")
        if not -1 < self.anisotropy < 1:
            raise SceneError(
                f"a medium has anisotropy {self.anisotropy}, but a mean cosine lies between −1 and 1 exclusive"
            )
        if not 1 <= self.ior <= GREATEST_IOR:
            raise SceneError(
                f"a medium has ior {self.ior}, but an index of refraction must lie from 1 to {GREATEST_IOR:g}"
            )

    @classmethod
    def of_albedo(
        cls, albedo: Triple, mean_free_path: Triple, anisotropy: float = 0.0, ior: float = 1.3
    ) -> "Subsurface":
        """From the single-scattering albedo in [0, 1] and the mean free path in metres, per channel."""
        share, path = np.asarray(albedo, float), np.asarray(mean_free_path, float)
        if share.shape != (3,) or not np.all((share >= 0) & (share <= 1)):
            raise SceneError(f"a medium has albedo {albedo}, but it must be three numbers from 0 to 1")
        if path.shape != (3,) or not np.all((path > 0) & np.isfinite(path)):
            raise SceneError(
                f"a medium has mean free path {mean_free_path}, but it must be three numbers above 0, in metres"
            )
        scattering, absorption = share / path, (1.0 - share) / path
        return cls((*map(float, scattering),), (*map(float, absorption),), anisotropy, ior)  # pyright: ignore

    @property
    def extinction(self) -> Float[np.ndarray, "3"]:
        """σ_t = σ_s + σ_a per metre: 1 over the mean free path."""
        return np.asarray(self.scattering, float) + np.asarray(self.absorption, float)

    @property
    def albedo(self) -> Float[np.ndarray, "3"]:
        """Single-scattering albedo σ_s / σ_t: the share of collisions that scatter."""
        return np.asarray(self.scattering, float) / self.extinction

    @property
    def grey(self) -> bool:
        """Whether all channels see the same medium."""
        return len(set(self.scattering)) == len(set(self.absorption)) == 1

    @property
    def reflected(self) -> float:
        """Share of diffuse light from outside that the boundary reflects before it enters."""
        return diffuse_reflectance(self.ior)


def fresnel(cosine: Float[np.ndarray, " n"], ior: float) -> Float[np.ndarray, " n"]:
    """Reflectance of a smooth boundary for unpolarised light at the cosine of incidence ≥ 0; `ior` is that of the far side
    over that of the near side. 1 where all light is reflected."""
    squared = 1.0 - (1.0 - cosine**2) / ior**2
    through = np.sqrt(np.maximum(squared, 0.0))
    # At grazing incidence on a matched boundary both sums vanish; nothing is reflected there.
    across = (cosine - ior * through) / np.maximum(cosine + ior * through, np.finfo(float).tiny)
    along = (ior * cosine - through) / np.maximum(ior * cosine + through, np.finfo(float).tiny)
    return np.where(squared > 0, 0.5 * (across**2 + along**2), 0.0 if ior == 1 else 1.0)


@lru_cache(maxsize=64)
def diffuse_reflectance(ior: float) -> float:
    """∫ 2μ F(μ) dμ over the cosine of incidence μ from 0 to 1: Fresnel reflectance for diffuse light, by quadrature."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    cosine = 0.5 * (node + 1.0)
    return float(np.sum(weight * cosine * fresnel(cosine, ior)))
