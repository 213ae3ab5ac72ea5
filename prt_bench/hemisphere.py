"""Quasi-random cosine-weighted directions for the hit table.

A fixed number of Owen-scrambled Sobol sets serves all points; each point picks one and turns it about its normal by an
angle of its own. That costs nine products per ray, where scrambling per point would cost a square root and a sine as well.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.stats import qmc

ONE_THREAD = {"xla_cpu_multi_thread_eigen": False}
"""For kernels that already run on every worker thread."""
_SETS = 64
SAMPLER = ("directions", "jitter")
"""Names of the arrays in a store that make a sampler again, beside its seed."""


class Turns(NamedTuple):
    """Each point's set of directions, and the frame that turns them: rows (tangent, bitangent, normal)."""

    chosen: Int[np.ndarray, " P"]
    frames: Float[np.ndarray, "P 3 3"]

    def __getitem__(self, rows: Any) -> "Turns":
        """Some points, for a slice."""
        return Turns(self.chosen[rows], self.frames[rows])


@dataclass(frozen=True)
class HemisphereSampler:
    """On the CPU device: `local` [sets, R, 3] are cosine-weighted directions about z, `jitter` two uniform offsets in ±½."""

    local: Float[Array, "sets R 3"]
    jitter: tuple[Float[Array, "sets R"], Float[Array, "sets R"]]
    seed: int

    @classmethod
    def create(cls, rays: int, seed: int) -> "HemisphereSampler":
        """Draw the sets. The halves of a set are nets themselves, so each estimates the gather on its own."""
        local, jitter = np.empty((_SETS, rays, 3), np.float32), np.empty((2, _SETS, rays), np.float32)
        for index, child in enumerate(np.random.SeedSequence([seed, rays]).spawn(_SETS)):
            count = 1 << max(rays - 1, 1).bit_length()
            points = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(child)).random(count)[:rays]
            radius, angle = np.sqrt(points[:, 0]), 2.0 * np.pi * points[:, 1]
            local[index] = np.stack(
                [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - points[:, 0])], axis=1
            )
            jitter[:, index] = points[:, 2:].T - 0.5
        return cls.stored(local, jitter, seed)

    @classmethod
    def stored(
        cls, local: Float[np.ndarray, "sets R 3"], jitter: Float[np.ndarray, "2 sets R"], seed: int
    ) -> "HemisphereSampler":
        """From what was drawn once; another version of the generator might draw other sets."""
        on_cpu = partial(jax.device_put, device=jax.devices("cpu")[0])
        return cls(on_cpu(local), (on_cpu(jitter[0]), on_cpu(jitter[1])), seed)

    def turns(self, first: int | Int[np.ndarray, " P"], normal: Float[np.ndarray, "P 3"]) -> Turns:
        """For the points `first`, `first` + 1, …, or the points given; independent of how points are grouped."""
        index = np.arange(first, first + len(normal)) if isinstance(first, int) else first
        index = index.astype(np.uint64)
        random = hashed(index + (np.uint64(self.seed) << np.uint64(40)))
        angle = (random >> np.uint64(11)).astype(np.float64) * (2.0 * np.pi / 2.0**53)
        return Turns((random % np.uint64(_SETS)).astype(np.int32), tangent_frames(normal, angle).astype(np.float32))

    def rays(
        self, origin: Float[np.ndarray, "P 3"], turns: Turns
    ) -> tuple[Float[Array, "P*R 3"], Float[Array, "P*R 3"]]:
        """Origins and directions of all rays of some points, point by point."""
        return _rays(self.local, *turns, origin)

    def directions(
        self, first: int | Int[np.ndarray, " P"], normal: Float[np.ndarray, "P 3"]
    ) -> Float[np.ndarray, "P R 3"]:
        """Directions alone, as `rays` gives them."""
        _, directions = self.rays(np.zeros_like(normal, np.float32), self.turns(first, normal))
        return np.asarray(directions).reshape(len(normal), -1, 3)


@partial(jax.jit, compiler_options=ONE_THREAD)
def _rays(local: Any, chosen: Any, frames: Any, origin: Any) -> tuple[Array, Array]:
    """local[chosen] · frames, written out: one fused pass, where a batch of 3 × 3 products costs four times as much."""
    x, y, z = jnp.split(local.at[chosen].get(mode="clip"), 3, axis=2)
    directions = x * frames[:, None, 0] + y * frames[:, None, 1] + z * frames[:, None, 2]
    origins = jnp.broadcast_to(origin[:, None], directions.shape)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


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


def hashed(values: Int[np.ndarray, " P"]) -> Int[np.ndarray, " P"]:
    """SplitMix64 finaliser: well-mixed 64-bit integers from consecutive ones."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
