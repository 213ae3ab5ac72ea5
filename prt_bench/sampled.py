"""Light at samples that have no lightmap: direct light by compressed visibility, indirect light by a transfer between clusters.

Puts `depth.py` and `clusters.py` together. Samples come from `data_gen/particles.py`, what rays from them meet from
`data_gen/meshless.py`; the same light in shaders, and as splats on the screen, is in `runtime/samples.py` and
`runtime/splats.py`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from prt_bench.clusters import apart, bases_of_clusters, in_clusters
from prt_bench.depth import ClusteredVisibility
from prt_bench.emitters import strength
from prt_bench.errors import FitError, LightError
from prt_bench.lights import Lighting, emitters
from prt_bench.linalg import fewer_columns
from prt_bench.packing import packed
from prt_bench.points import SurfacePoints

_SAME_WAY = 0.5  # cosine between normals from which two samples are of one surface
_AROUND = 24  # neighbours among which those are looked for
_COVERED_BY = 6  # of which a splat reaches

Bounced = Callable[[Float[np.ndarray, "S n"]], Float[np.ndarray, "S C n"]]
"""Indirect light of all bounces at the samples, in each channel, from columns of grey direct light there."""
_strength = jax.jit(strength)


class ClusteredTransfer(NamedTuple):
    """y_r = U_r Σ_s T_rs D_sᵀ E_s for receiver clusters r: indirect from direct irradiance at S samples in P clusters, in W/m².

    `sources` [S, Q] are the values of D and `receivers` [S, B] those of U at the samples, orthonormal in each cluster;
    `blocks` [C, P·B, P·Q] are T for each channel, all bounces included. Linear, and nothing is centred: see
    `methods/clustered_pca.py`. After "clustered PCA with local lights", eq. 10, whose receivers have no basis.
    """

    cluster: Int[np.ndarray, " S"]
    sources: Float[np.ndarray, "S Q"]
    receivers: Float[np.ndarray, "S B"]
    blocks: Float[np.ndarray, "C PB PQ"]

    @classmethod
    def fit(
        cls,
        light: Float[np.ndarray, "S n"],
        cluster: Int[np.ndarray, " S"],
        bounced: Bounced,
        sources: int = 10,
        receivers: int = 10,
    ) -> "ClusteredTransfer":
        """Bases of n columns of grey direct light, and of what their `sources` · P functions cause when each lights the scene.

        Raises `FitError` for NaN, and for sizes below 1.
        """
        if sources < 1 or receivers < 1:
            raise FitError(f"{sources} source and {receivers} receiver functions per cluster; both must be at least 1")
        if np.isnan(light).any():
            raise FitError("the direct light of the samples holds NaN; trace it again")
        count = int(cluster.max()) + 1
        emitting = bases_of_clusters(light, cluster, count, sources)
        response = bounced(apart(emitting, cluster, count))
        return cls.joined(light, cluster, emitting, response, receivers)

    @classmethod
    def joined(
        cls,
        light: Float[np.ndarray, "S n"],
        cluster: Int[np.ndarray, " S"],
        sources: Float[np.ndarray, "S Q"],
        response: Float[np.ndarray, "S C PQ"],
        receivers: int,
    ) -> "ClusteredTransfer":
        """The same from what each function of `sources` causes: `response`, one cluster's columns after another's."""
        count = int(cluster.max()) + 1
        spread = np.asarray(fewer_columns(jnp.asarray(in_clusters(sources, light, cluster, count))))
        caused = (response @ spread.astype(response.dtype)).reshape(len(response), -1)
        basis = bases_of_clusters(caused, cluster, count, receivers)
        blocks = np.moveaxis(in_clusters(basis, response, cluster, count), 1, 0)
        return cls(cluster, sources, basis, blocks)

    def coefficients(self, direct: Float[np.ndarray, "S C"]) -> Float[np.ndarray, "PQ C"]:
        """D_sᵀ E_s of all clusters."""
        return in_clusters(self.sources, direct, self.cluster, self.blocks.shape[2] // self.sources.shape[1])

    def indirect(self, direct: Float[np.ndarray, "S C"]) -> Float[np.ndarray, "S C"]:
        """Indirect irradiance at the samples in W/m² from direct irradiance in as many channels as were fitted."""
        inside = np.einsum("cbq,qc->bc", self.blocks, self.coefficients(direct))
        size = self.receivers.shape[1]
        first = self.cluster[:, None] * size + np.arange(size)
        return np.einsum("sb,sbc->sc", self.receivers, inside[first])

    def quantised(self) -> "ClusteredTransfer":
        """Bases in 16 bits and blocks in float32, as the runtime holds them."""
        return self._replace(
            sources=packed(self.sources).unpacked(),
            receivers=packed(self.receivers).unpacked(),
            blocks=self.blocks.astype(np.float32),
        )


class SampledLight(NamedTuple):
    """All that light at some samples needs: where they are, what they see, and what passes between them.

    `reach` [S] in m is how far the light of a sample is spread over the surface around it, see `reaches`; `walls` [S, 4, 2] in
    1/m are lines on that surface behind which it is not, see `data_gen.meshless.walls_around`.
    """

    points: SurfacePoints
    visibility: ClusteredVisibility
    transfer: ClusteredTransfer
    reach: Float[np.ndarray, " S"]
    walls: Float[np.ndarray, "S 4 2"]

    def direct(self, lighting: Lighting) -> Float[np.ndarray, "S 3"]:
        """Direct irradiance in W/m² with compressed shadows. Raises `LightError` for light from infinitely far away."""
        batch = emitters([lighting])
        position = np.asarray(batch.position[0])
        check_near(bool((position[:, 3] == 0).any()))
        points = jnp.asarray(self.points.position), jnp.asarray(self.points.normal)
        one = jax.tree.map(lambda leaf: leaf[0], batch)
        seen = self.visibility.lit(self.points, position[:, :3])
        return np.asarray(_strength(one, *points) * seen.T) @ np.asarray(one.intensity)

    def indirect(self, direct: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "S 3"]:
        """Indirect irradiance in W/m² that direct irradiance causes."""
        return self.transfer.indirect(direct)

    def quantised(self) -> "SampledLight":
        """As the runtime holds it, in 16 bits."""
        return self._replace(visibility=self.visibility.quantised(), transfer=self.transfer.quantised())


def check_near(distant: bool) -> None:
    """Raise `LightError` where a lighting has light from infinitely far away, of which buffers of depth know nothing."""
    if distant:
        raise LightError(
            "samples with compressed depth take points and areas, not directional or environment light; light them by a method"
            " of lightmaps instead"
        )


def reaches(points: SurfacePoints) -> Float[np.ndarray, " S"]:
    """How far in m the light of each sample is spread: to the sixth neighbour that faces the same way.

    So a place of a surface is reached from about seven samples, however densely they lie. Where fewer neighbours face that
    way it is the farthest of them; where none does, the nearest of all.
    """
    distance, near = KDTree(points.position).query(points.position, k=min(_AROUND, len(points)), workers=-1)
    distance, near = distance.reshape(len(points), -1), near.reshape(len(points), -1)
    same = np.einsum("pkd,pd->pk", points.normal[near], points.normal) > _SAME_WAY
    place = np.cumsum(same, axis=1)  # a sample is the first of its own neighbours
    last = np.argmax(place >= np.minimum(place[:, -1:], _COVERED_BY + 1), axis=1)
    found = distance[np.arange(len(points)), last]
    return np.where(found > 0, found, distance[:, min(1, distance.shape[1] - 1)])
