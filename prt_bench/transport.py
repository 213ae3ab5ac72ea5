"""Light transport as a linear map, traced once.

A hit table says for every receiver which gather sample each of its R cosine-weighted rays meets. Gathering is then a sparse
matrix with rows of equal weights 1/R, and every lighting, bounce, channel and method goes through the same matrix:

    E_ind = G ρ (E_dir + E_ind)

Where a scene has translucent bodies, light also enters at one sample and leaves at another. Walks through the medium make a
second table of hits, K, from irradiance to what leaves, and every ρ E above becomes ρ E + K E. A scene without such bodies has
no K, and runs what it always ran.

Rays are traced in `data_gen`; nothing here knows of geometry. Differentiable in direct light and albedo; hit indices are data.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import sparse
from jaxtyping import Array, Float, Int

from prt_bench.errors import FitError

_DEAD = 1e-9  # relative to the first bounce


class GatherOperator(eqx.Module):
    """G [P, S]: irradiance at P points from the radiosity of S samples.

    hits [P, R] holds a sample index per ray; the value S marks a ray that carries nothing (it met the back of a one-sided
    surface), S + 1 one that escaped from the scene. `adjoint` (row starts [S + 3], receivers [P·R]) is the table sorted by
    sample; with it gradients cost as much as values, without it they are several times slower.
    """

    hits: Int[Array, "P R"]
    samples: int = eqx.field(static=True)
    adjoint: tuple[Int[Array, " rows"], Int[Array, " hits"]] | None = None

    @classmethod
    def from_hits(cls, hits: Int[np.ndarray, "P R"], samples: int, differentiable: bool = False) -> "GatherOperator":
        """Wrap a hit table; `differentiable` sorts it once for fast gradients. Raises `FitError` for indices beyond S."""
        if hits.size and not 0 <= hits.min() <= hits.max() <= samples + 1:
            raise FitError(
                f"a hit table with entries from {hits.min()} to {hits.max()} does not index {samples} samples"
            )
        adjoint = None
        if differentiable:
            order = np.argsort(hits, axis=None, kind="stable")
            starts = np.searchsorted(hits.ravel()[order], np.arange(samples + 3))
            adjoint = (jnp.asarray(starts, jnp.int32), jnp.asarray(order // hits.shape[1], jnp.int32))
        return cls(jnp.asarray(hits, jnp.int32), samples, adjoint)

    def __call__(self, radiosity: Float[Array, "S K"]) -> Float[Array, "P K"]:
        """G · radiosity, one column per lighting and channel."""
        return _gather(self.hits, self.adjoint, jnp.pad(radiosity, ((0, 2), (0, 0))))


class Scattering(eqx.Module):
    """K [P, S]: what leaves P points of the surface of translucent bodies, W/m², from the irradiance at S samples.

    `rows` [p] are the translucent ones of the P points. Each of `walks` is a table of the samples where walks from those
    points left the body: the S of `GatherOperator` marks walks that were absorbed or never entered. One table serves all
    channels of a grey medium; otherwise there is one for each. Rows sum to at most 1 less what the boundary reflects.
    `colour` [p, C] is what the points' bodies return of light that is the same everywhere, see `shown`.

    With `scale` [p, D, H] each of the p points has H rows in a table one after another, and K is the mean over them, times the
    scale of row and channel. Strands of hair have such rows: light enters a path at many places, of which tables hold some.
    """

    rows: Int[Array, " p"]
    walks: tuple[GatherOperator, ...]
    colour: Float[Array, "p C"]
    scale: Float[Array, "p D H"] | None = None

    def __call__(self, irradiance: Float[Array, "S N C"]) -> Float[Array, "p N C"]:
        """K · irradiance at the points `rows`."""
        samples, lightings, channels = irradiance.shape
        if len(self.walks) == 1:
            found = self.walks[0](irradiance.reshape(samples, -1)).reshape(-1, lightings, channels)
        else:
            found = jnp.stack([walk(irradiance[:, :, c]) for c, walk in enumerate(self.walks)], axis=2)
        if self.scale is None:
            return found
        by_row = found.reshape(len(self.rows), self.scale.shape[2], lightings, channels)
        return jnp.mean(by_row * jnp.swapaxes(self.scale, 1, 2)[:, :, None].astype(found.dtype), axis=1)

    def channel(self, index: int) -> "Scattering":
        """The same of one channel alone."""
        medium = min(index, len(self.walks) - 1)
        scale = None if self.scale is None else self.scale[:, medium : medium + 1]
        return Scattering(self.rows, (self.walks[medium],), self.colour[:, index : index + 1], scale)

    def shares(self, u: Float[Array, "p B"]) -> Float[Array, "rows B"]:
        """What the rows of the table of one channel get of values at the points, going the other way."""
        if self.scale is None:
            return u
        share = self.scale[:, 0].astype(u.dtype) / self.scale.shape[2]
        return (share[:, :, None] * u[:, None]).reshape(share.size, u.shape[1])


@jax.custom_vjp
def _gather(hits: Array, adjoint: tuple[Array, Array] | None, padded: Array) -> Array:
    points, rays = hits.shape
    starts = jnp.arange(points + 1, dtype=jnp.int32) * rays
    return _sparse_product(hits.reshape(-1), starts, (points, padded.shape[0]), padded) / rays


def _gather_forward(hits: Array, adjoint: tuple[Array, Array] | None, padded: Array) -> tuple[Array, tuple]:
    return _gather(hits, adjoint, padded), (hits, adjoint, padded.shape[0])


def _gather_backward(residuals: tuple, cotangent: Array) -> tuple[None, None, Array]:
    hits, adjoint, rows = residuals
    points, rays = hits.shape
    if adjoint is None:
        spread = jnp.repeat(cotangent, rays, axis=0)
        gradient = jax.ops.segment_sum(spread, hits.reshape(-1), num_segments=rows)
    else:
        starts, receivers = adjoint
        gradient = _sparse_product(receivers, starts, (rows, points), cotangent)
    return None, None, gradient / rays


_gather.defvjp(_gather_forward, _gather_backward)


def _sparse_product(indices: Array, starts: Array, shape: tuple[int, int], dense: Array) -> Array:
    """Product of a 0/1 matrix in compressed rows (duplicates add up) with dense columns: JAX's fastest form on CPU."""
    ones = jnp.ones(indices.shape, dense.dtype)
    return sparse.BCSR((ones, indices, starts), shape=shape) @ dense


@partial(jax.jit, static_argnames="bounces")
def radiosity(
    gather: GatherOperator,
    albedo: Float[Array, "S C"],
    direct: Float[Array, "N S C"],
    bounces: int,
    scattering: Scattering | None = None,
) -> Float[Array, "S N C"]:
    """Radiosity (ρ + K) (E_dir + E_ind) at the gather samples, E_ind holding `bounces` bounces (0: direct light only).

    K is that of `scattering`, 0 without it. Neumann series of (I − G (ρ + K))⁻¹; its tail is bounded by `tail_bounds`. Units:
    W/m².
    """
    light = jnp.moveaxis(direct, 0, 1)  # one row per sample, so that a gather reads whole rows
    samples, lightings, channels = light.shape

    def leaving(irradiance: Array) -> Array:
        reflected = albedo[:, None, :] * irradiance
        return reflected if scattering is None else reflected.at[scattering.rows].add(scattering(irradiance))

    def bounce(_: int, indirect: Array) -> Array:
        return gather(leaving(light + indirect).reshape(samples, -1)).reshape(samples, lightings, channels)

    return leaving(light + jax.lax.fori_loop(0, bounces, bounce, jnp.zeros_like(light)))


@jax.jit
def final_gather(gather: GatherOperator, outgoing: Float[Array, "S N C"]) -> Float[Array, "N P C"]:
    """Irradiance at the receivers from the radiosity of the samples: the last bounce. Units: W/m²."""
    samples, lightings, channels = outgoing.shape
    received = gather(outgoing.reshape(samples, -1)).reshape(-1, lightings, channels)
    return jnp.moveaxis(received, 0, 1)


@jax.jit
def irradiance(
    gather: GatherOperator, direct: Float[Array, "N S C"], outgoing: Float[Array, "S N C"]
) -> Float[Array, "S N C"]:
    """All light that arrives at the samples, direct and gathered from their radiosity: what enters a medium. Units: W/m²."""
    return jnp.moveaxis(direct, 0, 1) + gather(outgoing.reshape(outgoing.shape[0], -1)).reshape(outgoing.shape)


@jax.jit
def shown(
    scattering: Scattering,
    albedo: Float[Array, "P C"],
    gathered: Float[Array, "N P C"],
    arriving: Float[Array, "S N C"],
) -> Float[Array, "N P C"]:
    """Indirect light as receivers show it, W/m²: irradiance E_ind, but (ρ E_ind + K E) / κ at translucent ones.

    `gathered` is E_ind at the receivers, `albedo` theirs, `arriving` the irradiance E at the samples. κ is the body's `colour`,
    a constant of its material and channel: what leaves is κ times as bright as this, just as a diffuse surface is ρ times as
    bright as its irradiance. So a viewer sees (ρ E_dir + κ y) / π at translucent points and ρ (E_dir + y) / π elsewhere.
    Nothing is divided by an albedo, which is usually 0 above a medium, and light has its own colour everywhere, so that a
    model that is shared by the channels serves coloured media as it serves coloured walls.
    """
    rows = scattering.rows
    leaving = albedo[rows] * gathered[:, rows] + jnp.moveaxis(scattering(arriving), 1, 0)
    return gathered.at[:, rows].set(leaving / scattering.colour[:, : albedo.shape[1]])


def indirect(
    gather: GatherOperator, albedo: Float[Array, "S C"], direct: Float[Array, "N S C"], bounces: int
) -> Float[Array, "N S C"]:
    """Indirect irradiance of `bounces` ≥ 1 bounces where receivers and samples coincide. Units: W/m²."""
    return final_gather(gather, radiosity(gather, albedo, direct, bounces - 1))


@jax.jit
def _with_brightest(leaving: Float[Array, "S 1"], scattering: Scattering, field: Float[Array, "S 1"]) -> Array:
    """`leaving` and what media add to it from the irradiance `field`, each in the channel where that is most."""
    channels = jnp.broadcast_to(field[:, :, None], (*field.shape, len(scattering.walks)))
    return leaving.at[scattering.rows].add(jnp.max(scattering(channels), axis=2))


def tail_bounds(
    gather: GatherOperator, albedo: Float[Array, "S C"], most: int, scattering: Scattering | None = None
) -> Float[np.ndarray, " bounces"]:
    """Upper bounds of the light that is missing after k = 1 … `most` bounces, relative to the brightest direct light.

    t_k = ‖(Gρ)^k 1‖∞ bounds bounce k, so Σ_{j>k} t_j bounds what is missing; with media ρ stands for ρ + K, each in its
    brightest channel. Terms are computed up to K = `most` + 1; as t is submultiplicative, every further K of them are together
    at most t_K times the K before. Fewer bounds are returned where light dies out earlier: the last one is then 0. Raises
    `FitError` when nothing decays (albedo 1 in a closed scene).
    """
    worst = jnp.max(albedo, axis=1)
    field = jnp.ones((albedo.shape[0], 1), albedo.dtype)
    decay = []
    for _ in range(most + 1):
        leaving = worst[:, None] * field
        field = gather(leaving if scattering is None else _with_brightest(leaving, scattering, field))
        decay.append(float(jnp.max(field)))
        # Among strands, which store no bounces of their own, light dies out long before its bound by albedo.
        if decay[-1] <= (_DEAD * decay[0] if scattering is not None and scattering.scale is not None else 0.0):
            break
    heights = np.array(decay)
    rate = min(heights[-1] ** (1.0 / len(heights)), 1.0)
    if rate >= 1.0 - 1e-6:
        raise FitError("light does not decay: a closed scene with albedo 1 keeps all energy; lower the largest albedo")
    # Σ_{j>k} t_j: computed terms, then blocks of len(heights) bounces shrinking by the last height each.
    beyond = heights.sum() * heights[-1] / (1.0 - heights[-1]) if heights[-1] < 1 else np.inf
    remaining = heights[::-1].cumsum()[::-1] + beyond
    return np.append(remaining[1:], beyond)[:most]
