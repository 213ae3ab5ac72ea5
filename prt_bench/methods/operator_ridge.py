"""The traced operator as a prior: ridge regression that knows what light between the training lightings would do.

`svd-ridge` learns from lightings alone what direct light looks like between the measurement points. The bake already holds
the operator that answers it, so light on single measurement cells joins the training lightings at no cost at run time.
"""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from prt_bench.dataset import LightingDataset, Transport
from prt_bench.linalg import leading_basis, relative_damping, ridge, safe_norm
from prt_bench.methods.base import Method
from prt_bench.methods.examples import Examples, normalised, training_light
from prt_bench.methods.linear import linear_model, warn_of_rank
from prt_bench.models import LinearModel
from prt_bench.points import SurfacePoints
from prt_bench.transport import GatherOperator, radiosity

_RECEIVERS = 8192  # rows of the receiver table in memory at once


@dataclass(frozen=True)
class OperatorRidge(Method):
    """u = Uᵀ 𝒮 Σ Aᵀ (A Σ Aᵀ + λ)⁻¹ x with the covariance Σ = (1 − prior) Σ_training + prior Σ_cells of direct light.

    A measures direct light, 𝒮 sends it through all bounces. Σ_cells is light that is constant on each measurement cell (the
    samples nearest to a measurement point and facing its way) and independent between cells; both covariances have the same
    trace at the measurement points. `prior` 0 is `svd-ridge` without its mean, 1 uses the lightings for the basis alone.
    The map is linear, so it is additive in the light as well as homogeneous. `ridge` is relative to the trace.
    """

    name: ClassVar[str] = "operator-ridge"
    summary: ClassVar[str] = "svd-ridge with the traced operator as a prior on light never seen"
    citation: ClassVar[str] = "this project: best linear estimate under a mixture of lightings and measurement cells"

    basis: int = 16
    ridge: float = 3e-2
    prior: float = 0.5

    def __post_init__(self) -> None:
        self.require(self.basis >= 1, "basis", "at least 1")
        self.require(0 <= self.ridge < float("inf"), "ridge", "zero or a positive number")
        self.require(0 <= self.prior <= 1, "prior", "from 0 to 1")

    def fit(self, ds: LightingDataset, key: jax.Array | None = None) -> LinearModel:
        """Fit in closed form; needs the transport that `ds` was baked with, as well as its lightings."""
        examples = normalised(*training_light(ds))
        u, values = leading_basis(examples.y, self.basis, examples.floor)
        coloured = ds.indirect.shape[2] > 1 and not ds.transport.scene.achromatic
        albedo = jnp.asarray(ds.transport.samples.albedo[:, : 3 if coloured else 1], jnp.float32)
        matrix = regress_with_cells(
            examples, u, cells(ds), importance(ds.transport, albedo, u), self.ridge, self.prior
        )  # fmt: skip
        model = linear_model(u, matrix, singular_values=values)
        warn_of_rank(self.label, model)
        return model


class Cells(NamedTuple):
    """Measurement cells: `of_sample` [S] the cell of each gather sample, `measured` [M, M] what cell j adds to point m."""

    of_sample: Int[np.ndarray, " S"]
    measured: Float[np.ndarray, "M M"]


def cells(ds: LightingDataset) -> Cells:
    """Assign samples to the nearest measurement point that faces the same way.

    Nearness is Euclidean in position and normal together; opposite normals count as four times the mean spacing of the
    measurement points, so that a cell neither leaks through a thin wall nor around a corner.
    """
    points = ds.measurement_points
    spacing = np.sqrt(ds.transport.scene.mesh.areas.sum() / len(points))

    def feature(of: SurfacePoints) -> Float[np.ndarray, "P 6"]:
        return np.hstack([of.position, 2.0 * spacing * of.normal])

    tree = KDTree(feature(points))
    _, of_sample = tree.query(feature(ds.transport.samples))
    _, of_dense = tree.query(feature(ds.dense_points))
    groups = np.asarray(ds.groups)
    measured = np.zeros((len(points), len(points)))
    np.add.at(measured, (np.arange(len(points))[:, None], np.asarray(of_dense)[groups]), 1.0 / groups.shape[1])
    return Cells(of_sample, measured)


def importance(transport: Transport, albedo: Float[Array, "S C"], u: Float[Array, "T B"]) -> Float[Array, "C S B"]:
    """𝒮ᵀ U: what direct light at each sample adds to each coefficient, through all bounces.

    The adjoint operator carries B columns where the forward one would carry one for each of M cells. Differentiable in u
    and albedo; float32, as the bake.
    """
    u = u.astype(jnp.float32)
    received = jnp.zeros((len(transport.samples), u.shape[1]), jnp.float32)
    for start in range(0, u.shape[0], _RECEIVERS):
        rows = slice(start, start + _RECEIVERS)
        received += _transposed_gather(transport.receiver_gather(rows), u[rows])
    gather = transport.sample_gather(differentiable=True)
    return jnp.stack(
        [_transposed_bounces(gather, albedo[:, c : c + 1], received, transport.bounces) for c in range(albedo.shape[1])]
    )


@jax.jit
def _transposed_gather(gather: GatherOperator, u: Float[Array, "P B"]) -> Float[Array, "S B"]:
    _, transposed = jax.vjp(gather, jnp.zeros((gather.samples, u.shape[1]), u.dtype))
    return transposed(u)[0]


@partial(jax.jit, static_argnames="bounces")
def _transposed_bounces(
    gather: GatherOperator, albedo: Float[Array, "S 1"], received: Float[Array, "S B"], bounces: int
) -> Float[Array, "S B"]:
    def outgoing(direct: Float[Array, "B S 1"]) -> Float[Array, "S B 1"]:
        return radiosity(gather, albedo, direct, bounces - 1)

    _, transposed = jax.vjp(outgoing, jnp.zeros((received.shape[1], received.shape[0], 1), received.dtype))
    return transposed(received[:, :, None])[0][:, :, 0].T


@jax.jit
def regress_with_cells(
    examples: Examples,
    u: Float[Array, "T B"],
    light: Cells,
    adjoint: Float[Array, "C S B"],
    ridge_factor: float | Float[Array, ""],
    prior: float | Float[Array, ""],
) -> Float[Array, "C B M"]:
    """One matrix per channel of `adjoint`: ridge regression on training lightings and cells, each set of trace 1.

    A covariance that is a sum of outer products makes the estimate a regression on its columns, scaled.
    """
    channels, measurements = adjoint.shape[0], examples.x.shape[0]
    coefficients = jnp.matmul(u.T, examples.y, precision="highest")
    from_cells = jax.vmap(lambda a: jax.ops.segment_sum(a, light.of_sample, measurements).T)(
        adjoint.astype(jnp.float64)
    )
    cell_scale = _scale(prior, light.measured)

    def matrix(c: int) -> Float[Array, "B M"]:
        lightings = slice(c, None, channels)
        scale = _scale(1.0 - prior, examples.x[:, lightings])
        x = jnp.concatenate([scale * examples.x[:, lightings], cell_scale * light.measured], axis=1)
        targets = jnp.concatenate([scale * coefficients[:, lightings], cell_scale * from_cells[c]], axis=1)
        return ridge(x, targets, relative_damping(x, ridge_factor))

    return jnp.stack([matrix(c) for c in range(channels)])


def _scale(share: float | Array, columns: Float[Array, "M n"]) -> Float[Array, ""]:
    """The factor that gives the columns' outer products the trace `share`; 0 where all columns are black."""
    size = safe_norm(columns.ravel(), axis=0)[0]
    return jnp.where(size > 0, jnp.sqrt(share) / jnp.where(size > 0, size, 1.0), 0.0)
