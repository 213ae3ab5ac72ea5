"""Clustered PCA: direct light of each cluster on principal components of its own, which are sent into the scene one by one."""

import warnings
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from prt_bench.clustered import ClusteredModel
from prt_bench.clusters import apart, bases_of_clusters, clusters_of, in_clusters
from prt_bench.dataset import LightingDataset
from prt_bench.errors import DatasetError, FitError
from prt_bench.linalg import fewer_columns, relative_damping, ridge, safe_norm
from prt_bench.methods.base import Method
from prt_bench.methods.examples import Examples, column_scale, normalised, training_light
from prt_bench.methods.operator import fit_albedo, respond
from prt_bench.methods.operator_ridge import RIDGES, Auto
from prt_bench.methods.prior import mixed, prior_columns


@dataclass(frozen=True)
class ClusteredPCA(Method):
    """y_r = U_r U_rᵀ Σ_s 𝒮_rs D_s c_s for receiver clusters r, with c_s ≈ D_sᵀ E_s estimated from the measured light.

    The surface falls into `clusters`. D_s are the `sources` leading singular vectors of the direct light E_s of cluster s at
    the gather samples under many lightings; each lights the scene once, through all bounces of the traced operator 𝒮 (light
    is linear, so its negative parts may be sent too). U_r are the `basis` leading ones of what this causes in cluster r,
    so that a receiver stores `basis` values however large the scene is. Nothing is centred: the paper takes a mean from the
    light first, which makes its map affine, so that it errs for light of another intensity. Here the mean's direction is
    among the vectors, and the map is linear.

    Lightings are the dataset's streamed ones; where it has none, the training lightings with the light between measurement
    points interpolated. `prior` and `ridge` act as in `streamed-ridge`.
    """

    name: ClassVar[str] = "clustered-pca"
    summary: ClassVar[str] = (
        "bases of direct and of indirect light for each cluster of the surface, joined by the operator"
    )
    citation: ClassVar[str] = "clustered PCA with local lights, eq. 10, without its mean"
    differentiable: ClassVar[bool] = False

    basis: int = 10
    clusters: int = 16
    sources: int = 10
    ridge: float | Auto = "auto"
    prior: float = 0.02

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(1 <= self.clusters <= 2048, "clusters", "from 1 to 2048")
        self.require(self.sources >= 1, "sources", "at least 1")
        self.require(self.ridge == "auto" or 0 <= self.ridge < float("inf"), "ridge", "zero, positive or 'auto'")
        self.require(0 <= self.prior <= 1, "prior", "from 0 to 1")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> ClusteredModel:
        """Fit in closed form; needs the transport of `ds`. Raises `FitError` where the light is traced."""
        if isinstance(ds.measured, Tracer) or isinstance(ds.indirect, Tracer):
            raise FitError(
                f"{self.name} has no derivatives in its training light; differentiate streamed-ridge instead"
            )
        trained = normalised(*training_light(ds))
        transport = ds.transport
        bend = float(np.sqrt(transport.scene.mesh.areas.sum() / self.clusters))  # the side of a cluster
        clusters = clusters_of(transport.receivers, self.clusters, bend)
        senders, receivers = clusters.owner(transport.samples), clusters.owner(transport.receivers)
        count = len(clusters)

        # D, c = Dᵀ E, and R = 𝒮 D in each channel
        x, direct = _lightings(ds, trained)
        emitted = apart(bases_of_clusters(direct, senders, count, self.sources), senders, count)
        response = np.asarray(respond(transport, fit_albedo(ds), emitted), np.float64)
        x, sent = _sized(x, jnp.asarray(emitted.T @ direct), response)

        # U, and Uᵀ R
        spread = np.asarray(fewer_columns(sent))
        basis = bases_of_clusters((response @ spread).reshape(len(response), -1), receivers, count, self.basis)
        self._warn_of_rank(basis, receivers)
        projected = np.moveaxis(in_clusters(basis, response, receivers, count), 1, 0)

        cells = prior_columns(ds, "cells")
        patterns = jnp.asarray(cells.measured), jnp.asarray(emitted.T @ cells.direct)
        wanted = in_clusters(basis, np.asarray(trained.y), receivers, count)
        ridges = jnp.asarray(RIDGES if self.ridge == "auto" else (self.ridge,))
        matrix = _regressed(*mixed((x, sent), patterns, self.prior), projected, trained.x, wanted, ridges)
        return ClusteredModel(
            jnp.asarray(basis), jnp.asarray(receivers, jnp.float64), jnp.pad(matrix, ((0, 0), (0, 0), (0, 1)))
        )

    def _warn_of_rank(self, basis: Float[np.ndarray, "T K"], owner: Int[np.ndarray, " T"]) -> None:
        """Warn when light leaves functions empty that a cluster has receivers for."""
        empty = 0
        for cluster in np.unique(owner):
            rows = basis[owner == cluster]
            empty += min(self.basis, len(rows)) - int(np.any(rows, axis=0).sum())
        if empty:
            warnings.warn(
                f"{self.label}: the lightings have too small a rank in some clusters; {empty} basis functions are zero",
                stacklevel=3,
            )


def _lightings(ds: LightingDataset, trained: Examples) -> tuple[Float[np.ndarray, "M n"], Float[np.ndarray, "S n"]]:
    """Grey light at the measurement points and at the gather samples, as bright on average in every column."""
    try:
        x, direct = ds.streamed.measured.T.astype(np.float64), np.asarray(ds.streamed.direct[:]).T.astype(np.float64)
    except DatasetError:  # the dataset has no streamed lightings
        x = np.asarray(trained.x)
        direct = prior_columns(ds, "surface").direct @ x
    size = np.asarray(safe_norm(jnp.asarray(direct), axis=0))
    scale = np.where(size > 0, len(direct) ** 0.5 / np.where(size > 0, size, 1.0), 0.0)
    return x * scale, direct * scale


def _sized(
    x: Float[np.ndarray, "M n"], sent: Float[Array, "Q n"], response: Float[np.ndarray, "T C Q"]
) -> tuple[Float[Array, "M n"], Float[Array, "Q n"]]:
    """Both over the size of the indirect light that is caused, as `normalised` does by "indirect"."""
    flat = response.reshape(-1, response.shape[2])
    caused = jnp.einsum("qn,qp,pn->n", sent, jnp.asarray(flat.T @ flat), sent, precision="highest")
    received = jnp.sqrt(jnp.maximum(caused / response.shape[1], 0.0))
    scale, _ = column_scale(jnp.asarray(x), received[None], len(response), "indirect")
    return jnp.asarray(x) * scale, sent * scale


@jax.jit
def _regressed(
    x: Float[Array, "M n"], sent: Float[Array, "Q n"], projected: Float[Array, "C B Q"],
    trained: Float[Array, "M k"], wanted: Float[Array, "B k"], ridges: Float[Array, " R"],
) -> Float[Array, "C B M"]:  # fmt: skip
    """The matrices from measured light to coefficients, for the ridge with the least error on training lightings."""
    found = jax.vmap(lambda factor: ridge(x, sent, relative_damping(x, factor)))(ridges)
    matrices = jnp.einsum("cbq,rqm->rcbm", projected, found, precision="highest")
    channels = len(projected)
    missed = [
        jnp.einsum("rbm,mk->rbk", matrices[:, c], trained[:, c::channels], precision="highest") - wanted[:, c::channels]
        for c in range(channels)
    ]
    return matrices[jnp.argmin(sum(jnp.sum(each**2, axis=(1, 2)) for each in missed))]
