"""Reduced transfer within a cube with missing faces: a prior on direct light, and the indirect light it can cause.

F carries radiosity to irradiance (`cube.one_bounce`), P is a basis of plausible light with weights S, M = F P S = U Σ Vᵀ. The
source paper scales its basis, U_b = U Σ, and reads b = Vᵀ S⁻¹ Pᵀ l; here U_b = U and b = Uᵀ F P Pᵀ l, which is the same light
U_b b without S⁻¹, whose entries grow without bound with the size of the prior. All in float64; nothing is differentiated.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from prt_bench.emitters import Emitters, irradiance
from prt_bench.errors import FitError
from prt_bench.lights import Lighting, SphereLight, emitters
from prt_bench.linalg import svd
from prt_bench.modular.cube import FACES, inward, one_bounce, sample_points

RADIUS = 0.05
"""Of the sphere lights of the prior, in edges of the cube."""
SHARE_OUTSIDE = 4
"""One light beyond a missing face for so many within."""
_COLUMNS = 64
_FLOOR = 1e-9  # singular values below this share of the largest are rounding


class Modes(NamedTuple):
    """What a cube with missing faces keeps.

    `basis` [n, B] orthonormal indirect irradiance, `read` [B, n] from radiosity to its coefficients, `implicit` [n, B] the
    radiosity whose one bounce is the basis, `decay` the singular values of M, `prior` [n, k] the radiosity of plausible light,
    P S: independent columns, each as strong as it is likely.
    """

    basis: Float[np.ndarray, "n B"]
    read: Float[np.ndarray, "B n"]
    implicit: Float[np.ndarray, "n B"]
    decay: Float[np.ndarray, " k"]
    prior: Float[np.ndarray, "n k"]


def factors(matrix: Float[np.ndarray, "m n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thin SVD U, σ, Vᵀ as NumPy arrays."""
    u, s, vt = _svd(jnp.asarray(matrix))
    return np.asarray(u), np.asarray(s), np.asarray(vt)


_svd = jax.jit(svd)  # one compilation for a shape, where its drivers one by one are a dozen


def present(side: int, missing: Sequence[int]) -> Bool[np.ndarray, " n"]:
    """Which samples lie on faces that are there."""
    return ~np.isin(np.repeat(np.arange(FACES), side * side), np.asarray(missing, int))


def direct_light(side: int, missing: Sequence[int], lights: int) -> Float[np.ndarray, "n m"]:
    """L: irradiance by `lights` sphere lights spread evenly in the cube, and by a quarter as many behind each missing face.

    Nothing stands between a light behind a missing face and the cube's samples, for the two cubes together are convex.
    """
    within, beyond = _all_light(side, lights)
    light = np.concatenate([within, *(beyond[face] for face in missing)], axis=1)
    return light * present(side, missing)[:, None]


@cache
def _all_light(side: int, lights: int) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "6 n o"]]:
    """Light by the spheres within a closed cube, and by those in the cube behind each of its faces were that missing."""
    within = (1.0 - 2.0 * RADIUS) * (spread(lights) - 0.5)
    behind = within[::SHARE_OUTSIDE] - inward(np.arange(FACES))[:, None]
    light = sphere_light(np.concatenate([within, *behind]), *sample_points(side))
    return light[:, :lights], light[:, lights:].reshape(len(light), FACES, -1).swapaxes(0, 1)


def sphere_light(
    place: Float[np.ndarray, "m 3"], position: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n m"]:
    """Irradiance by a sphere light at each place, with nothing between."""
    batch = emitters([Lighting([SphereLight(each, RADIUS, jnp.ones(3))]) for each in place])
    return np.asarray(_from_each(batch, jnp.asarray(position), jnp.asarray(normal)), np.float64).T


@jax.jit
def _from_each(batch: Emitters, position: Array, normal: Array) -> Float[Array, "m n"]:
    return jax.lax.map(lambda each: irradiance(each, position, normal)[:, 0], batch)


def spread(count: int) -> Float[np.ndarray, "m 3"]:
    """Evenly spread points in the unit cube: multiples of the powers of the root of x⁴ = x + 1, without their whole parts."""
    root = 1.2207440846057596
    return np.mod(0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, 4.0), 1.0)


def enriched(parts: Sequence[Float[np.ndarray, "n k"]], count: int) -> tuple[np.ndarray, np.ndarray]:
    """P [n, k] and S [k]: left singular vectors and values of all parts, each scaled to unit Frobenius norm.

    Parts that are zero say nothing and are left out. k ≤ `count` is the number of singular values above rounding. Raises
    `FitError` where no part is left, or where one is not finite.
    """
    if not all(np.all(np.isfinite(part)) for part in parts):
        raise FitError("light that is to be in the prior of a block is not finite")
    sizes = [np.linalg.norm(part) for part in parts]
    kept = [part / size for part, size in zip(parts, sizes, strict=True) if size > 0]
    if not kept:
        raise FitError("no light at all is to be in the prior of a block; put lights into it")
    columns = np.concatenate(kept, axis=1)
    spare = -columns.shape[1] % _COLUMNS  # zeros change nothing on the left, and few shapes are compiled
    u, s, _ = factors(np.pad(columns, ((0, 0), (0, spare))))
    rank = min(count, int(np.sum(s > _FLOOR * s[0])))
    return u[:, :rank], s[:rank]


def reduced(side: int, missing: Sequence[int], functions: int = 32, prior: int = 64, lights: int = 63) -> Modes:
    """The modes of a cube without the faces `missing`.

    The prior is enriched by functions that are constant on one face, and by the indirect light of the prior without it, so
    that surfaces of unlike albedo and further bounces lie in its span. A face by itself sends no light to itself: its modes are
    those of what it sends out through the missing faces, on which their basis lies.
    """
    here = present(side, missing)
    alone = len(set(missing)) == FACES - 1
    transport = one_bounce(side) * (~here if alone else here)[:, None] * here
    light = direct_light(side, missing, lights)
    constants = (np.repeat(np.eye(FACES), side * side, axis=0) * here[:, None])[
        :, np.setdiff1d(np.arange(FACES), missing)
    ]
    return refined(transport, light, constants, functions, prior)


def refined(
    transport: Float[np.ndarray, "n n"],
    light: Float[np.ndarray, "n m"],
    constants: Float[np.ndarray, "n c"],
    functions: int,
    prior: int,
) -> Modes:
    """The modes of an operator under this light, enriched by constants and by the indirect light it causes on what sends."""
    sends = np.any(transport != 0, axis=0)
    first = _modes(transport, *enriched([light], prior), functions)
    bounced = first.basis * first.decay[: first.basis.shape[1]]
    return _modes(transport, *enriched([light, constants, bounced * sends[:, None]], prior), functions)


def _modes(transport: np.ndarray, basis: np.ndarray, weights: np.ndarray, functions: int) -> Modes:
    bounced = transport @ basis
    u, s, vt = factors(bounced * weights)
    rank = min(functions, int(np.sum(s > _FLOOR * s[0])))
    u, vt = u[:, :rank], vt[:rank]
    return Modes(u, (u.T @ bounced) @ basis.T, (basis * weights) @ (vt.T / s[:rank]), s, basis * weights)


def needed(values: Float[np.ndarray, " k"], share: float) -> int:
    """How many singular values, from the largest, hold a share of the energy: of the sum of their squares."""
    return int(np.searchsorted(np.cumsum(values**2) / np.sum(values**2), share) + 1)


def series(onwards: Float[np.ndarray, "*c B B"], bounces: int) -> Float[np.ndarray, "*c B B"]:
    """1 + R + … + R^(bounces − 1), R from light after one bounce to that after the next; by halves."""
    identity = np.broadcast_to(np.eye(onwards.shape[-1]), onwards.shape)
    if bounces == 1:
        return identity
    half = series(onwards, bounces // 2)
    total = half + np.linalg.matrix_power(onwards, bounces // 2) @ half
    return identity + onwards @ total if bounces % 2 else total
