"""Quasi-random cosine-weighted directions for the hit table.

A fixed number of Owen-scrambled Sobol sets serves all points; each point picks one and turns it about its normal by an
angle of its own. That costs nine products per ray, where scrambling per point would cost a square root and a sine as well.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.stats import qmc

_SETS = 64


@dataclass(frozen=True)
class HemisphereSampler:
    """`local` [sets, R, 3] are cosine-weighted directions about z, `jitter` [sets, R, 2] uniform offsets in ±½."""

    local: Float[Array, "sets R 3"]
    jitter: Float[np.ndarray, "sets R 2"]
    seed: int

    @classmethod
    def create(cls, rays: int, seed: int) -> "HemisphereSampler":
        """Draw the sets. The halves of a set are nets themselves, so each estimates the gather on its own."""
        local, jitter = np.empty((_SETS, rays, 3), np.float32), np.empty((_SETS, rays, 2), np.float32)
        for index, child in enumerate(np.random.SeedSequence([seed, rays]).spawn(_SETS)):
            count = 1 << max(rays - 1, 1).bit_length()
            points = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(child)).random(count)[:rays]
            radius, angle = np.sqrt(points[:, 0]), 2.0 * np.pi * points[:, 1]
            local[index] = np.stack(
                [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - points[:, 0])], axis=1
            )
            jitter[index] = points[:, 2:] - 0.5
        with jax.default_device(jax.devices("cpu")[0]):
            return cls(jnp.asarray(local), jitter, seed)

    def directions(
        self, first: int, normal: Float[np.ndarray, "P 3"]
    ) -> tuple[Float[np.ndarray, "P R 3"], Float[np.ndarray, "P R 2"]]:
        """Directions and jitter for the points `first`, `first` + 1, …; independent of how points are grouped."""
        index = np.arange(first, first + len(normal), dtype=np.uint64)
        random = _hash(index + (np.uint64(self.seed) << np.uint64(40)))
        chosen = (random % np.uint64(_SETS)).astype(np.int64)
        angle = (random >> np.uint64(11)).astype(np.float64) * (2.0 * np.pi / 2.0**53)
        frames = tangent_frames(normal, angle).astype(np.float32)
        with jax.default_device(jax.devices("cpu")[0]):
            return np.asarray(_turn(self.local, chosen, frames)), self.jitter[chosen]


@jax.jit
def _turn(local: Any, chosen: Any, frames: Any) -> Array:
    """local[chosen] · frames, written out: one fused pass, where a batch of 3 × 3 products costs four times as much."""
    x, y, z = jnp.split(local.at[chosen].get(mode="clip"), 3, axis=2)
    return x * frames[:, None, 0] + y * frames[:, None, 1] + z * frames[:, None, 2]


def tangent_frames(normal: Float[np.ndarray, "P 3"], angle: Float[np.ndarray, " P"]) -> Float[np.ndarray, "P 3 3"]:
    """Rows (tangent, bitangent, normal), turned about the normal by `angle`.

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited": no branch, no singular direction.
    """
    x, y, z = normal.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangent = np.stack([b, sign + y * y * a, -y], axis=1)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack([cosine * tangent + sine * bitangent, cosine * bitangent - sine * tangent, normal], axis=1)


def _hash(values: Int[np.ndarray, " P"]) -> Int[np.ndarray, " P"]:
    """SplitMix64 finaliser: well-mixed 64-bit integers from consecutive ones."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
