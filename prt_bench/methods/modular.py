"""Modular radiance transfer: light within boxes that stand for a scene, by transport that is the same for all boxes.

Nothing of the scene is traced or learned. Its surfaces tell which faces a box has and how bright they are; all else is
the reduced transport of cubes (`prt_bench.modular`), which no light that is asked for and no geometry changes.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from prt_bench.clustered import ClusteredModel
from prt_bench.dataset import LightingDataset
from prt_bench.linalg import relative_damping, ridge
from prt_bench.methods.base import Method
from prt_bench.methods.linear import linear_model
from prt_bench.methods.operator import fit_albedo
from prt_bench.models import LinearModel
from prt_bench.modular.block import Box, missing_faces, modes_of, observation, on_faces, received
from prt_bench.modular.dictionary import Dictionary, standard
from prt_bench.modular.joined import joined
from prt_bench.modular.modes import series
from prt_bench.modular.placed import Placed


@dataclass(frozen=True)
class Modular(Method):
    """y = U_p Σ_k (R)^k W ρ x: radiosity ρ x at the measurement points, read as light of the cube's prior.

    W = UᵀF Σ Aᵀ (A Σ Aᵀ + λ)⁻¹ is the best linear estimate of the first bounce under the prior Σ = (P S)(P S)ᵀ, where A has
    the cube's light at the points; R = UᵀF P Pᵀ ρ U carries each bounce to the next, for as many as the bake has; U_p is what
    points at the receivers get of the light behind U. `ridge` is λ relative to the prior's light at the points. For scenes
    that are about a box: light that a body keeps from a wall is not kept from it here.

    With a `level`, a TOML file of blocks on a grid (`modular.placed`) or a folder that has one with the scene's name, there is
    such a box for each room, light passes between them through sides without walls, `depth` of them at most, and `basis`
    functions are kept for each. What their dictionary holds is computed once and kept in the user's cache folder.
    """

    name: ClassVar[str] = "modular"
    summary: ClassVar[str] = (
        "modular radiance transfer of one box or a level of them: no precomputation of the scene's light"
    )
    citation: ClassVar[str] = "loos2011modular"
    learns: ClassVar[bool] = False

    basis: int = 32
    ridge: float = 1e-2
    side: int = 12
    lights: int = 63
    level: str = ""
    depth: int = 8

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(0 <= self.ridge < float("inf"), "ridge", "zero or positive")
        self.require(4 <= self.side <= 32, "side", "from 4 to 32")
        self.require(self.lights >= 1, "lights", "at least 1")
        self.require(self.depth >= 1, "depth", "at least 1")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> LinearModel | ClusteredModel:
        """In closed form, from points and albedo alone; the light of `ds` is not looked at.

        Raises `SpecError` for a file that holds no level, and `FitError` for points where it has no block.
        """
        return self._joined(ds) if self.level else self._one_box(ds)

    def dictionary(self, dimension: int = 2) -> Dictionary:
        """The dictionary of levels for these settings, computed where it is not kept yet; `dimension` as in `build`."""
        size = max(self.basis, 32)
        more = {"dimension": dimension} if dimension > 2 else {}
        return standard(side=self.side, functions=size, prior=2 * size, lights=self.lights, **more)

    def _joined(self, ds: LightingDataset) -> ClusteredModel:
        transport, path = ds.transport, Path(self.level)
        placed = Placed.load(path / f"{transport.scene.name}.toml" if path.is_dir() else path)
        area = float(transport.scene.mesh.areas.sum()) / len(transport.samples)
        dictionary = self.dictionary(placed.level.dimension)
        basis, block, matrix = joined(
            placed, dictionary, ds.measurement_points, transport.samples, transport.receivers, area,
            self.basis, self.ridge, transport.bounces, self.depth, fit_albedo(ds).shape[1],
        )  # fmt: skip
        weights = jnp.pad(jnp.asarray(matrix), ((0, 0), (0, 0), (0, 1)))
        return ClusteredModel(jnp.asarray(basis), jnp.asarray(block, jnp.float64), weights)

    def _one_box(self, ds: LightingDataset) -> LinearModel:
        points, samples, scene = ds.measurement_points, ds.transport.samples, ds.transport.scene
        box = Box.around(scene.bounds)
        prior = 2 * max(self.basis, 32)
        modes = modes_of(self.side, missing_faces(box, scene.mesh), self.basis, prior, self.lights)
        seen = observation(box, points, self.side)
        channels = fit_albedo(ds).shape[1]
        albedo = np.asarray(points.albedo[:, :channels], float)
        first = _first_bounce(jnp.asarray(seen @ modes.prior), jnp.asarray(modes.read @ modes.prior), self.ridge)
        reflects = on_faces(observation(box, samples, self.side), np.asarray(samples.albedo[:, :channels], float))
        onwards = np.einsum("bn,nc,nd->cbd", modes.read, reflects, modes.basis, optimize=True)
        sums = series(onwards, ds.transport.bounces)
        matrix = np.einsum("cij,jm,mc->cim", sums, np.asarray(first), albedo)
        basis = received(box, ds.transport.receivers, modes.implicit, self.side)
        spare = self.basis - basis.shape[1]
        return linear_model(
            jnp.asarray(np.pad(basis, ((0, 0), (0, spare)))), jnp.asarray(np.pad(matrix, ((0, 0), (0, spare), (0, 0))))
        )


@jax.jit
def _first_bounce(
    measured: Float[Array, "M k"], bounced: Float[Array, "B k"], ridge_factor: float
) -> Float[Array, "B M"]:
    return ridge(measured, bounced, relative_damping(measured, ridge_factor))
