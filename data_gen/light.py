"""Lighting a traced scene: direct light by shadow rays, indirect light by the operator, for all lightings at once."""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from data_gen.decisions import Plan
from data_gen.direct import direct_irradiance
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.emitters import Emitters
from prt_bench.points import SurfacePoints
from prt_bench.transport import final_gather, irradiance, radiosity, shown

_NODES = 1 << 14  # nodes whose rays are in memory at once


@dataclass(frozen=True)
class Received:
    """Light at some receivers: direct and indirect irradiance, the estimate from the first half of the rays, and per
    lighting the sums of squares of (noise, signal) that make the noise floor."""

    direct: Float[np.ndarray, "N P C"]
    indirect: Float[np.ndarray, "N P C"]
    half: Float[np.ndarray, "N P C"]
    squares: Float[np.ndarray, "2 N"]


class LightPass:
    """N lightings on one traced scene; `receive` serves any range of receivers.

    Both halves of the rays bounce light on their own; their mean is the estimate, half their difference the noise.
    """

    def __init__(self, transport: Transport, tracer: Tracer, emitters: Emitters, settings: Plan) -> None:
        self.transport = transport
        self.tracer = tracer
        self.emitters = emitters
        self.shadow_rays = settings.needs_shadow_rays(transport.scene, emitters)
        white = bool(np.all(np.ptp(np.asarray(emitters.intensity), axis=-1) == 0))
        self.channels = 1 if settings.channels == 1 and white else 3

    def __len__(self) -> int:
        return self.emitters.position.shape[0]

    @cached_property
    def sent(self) -> list[Float[Array, "S N C"]]:
        """Radiosity of the gather samples after all bounces but the last, from each half of the rays."""
        samples = self.transport.samples
        albedo = jnp.asarray(samples.albedo[:, : self.channels], jnp.float32)
        direct = jnp.asarray(self._direct(samples))
        bounces = self.transport.bounces - 1
        return [
            radiosity(
                self.transport.sample_gather(half), albedo, direct, bounces, self.transport.sample_scattering(half)
            ).block_until_ready()
            for half in (0, 1)
        ]

    @cached_property
    def _arriving(self) -> list[Float[Array, "S N C"]]:
        """All light at the gather samples, which enters translucent bodies, from each half of the rays."""
        direct = jnp.asarray(self._direct(self.transport.samples))
        return [irradiance(self.transport.sample_gather(half), direct, self.sent[half]) for half in (0, 1)]

    @cached_property
    def _at_nodes(self) -> list[Float[np.ndarray, "N J C"]]:
        """Indirect light at the nodes, where not all receivers were traced, from each half of the rays."""
        traced = self.transport.traced
        parts = [slice(at, at + _NODES) for at in range(0, len(traced.receivers), _NODES)]
        return [
            np.concatenate(
                [np.asarray(final_gather(traced.receiver_gather(rows, half), light)) for rows in parts], axis=1
            )
            for half, light in enumerate(self.sent)
        ]

    def receive(self, rows: slice) -> Received:
        """Direct and indirect light at the receivers `rows`."""
        direct = self._direct(self.transport.receivers[rows])
        first, second = (self._received(rows, half) for half in (0, 1))
        mean, squares = _combine(first, second)
        return Received(direct, np.asarray(mean), np.asarray(first), np.asarray(squares))

    def _received(self, rows: slice, half: int) -> Float[Array, "N P C"]:
        gathered = self._gathered(rows, half)
        scattering = self.transport.receiver_scattering(rows, half)
        if scattering is None:
            return gathered
        albedo = jnp.asarray(self.transport.receivers.albedo[rows, : self.channels], jnp.float32)
        return shown(scattering, albedo, gathered, self._arriving[half])

    def _gathered(self, rows: slice, half: int) -> Float[Array, "N P C"]:
        if self.transport.nodes is None:
            return final_gather(self.transport.receiver_gather(rows, half), self.sent[half])
        at_nodes = np.moveaxis(self._at_nodes[half], 1, 0)
        return jnp.asarray(np.moveaxis(self.transport.spread(at_nodes, rows), 0, 1))

    def measured(self, dense: SurfacePoints, groups: Int[np.ndarray, "M s"]) -> Float[np.ndarray, "N M C"]:
        """Direct light at the measurement points: the mean over each group of dense points."""
        return self._direct(dense)[:, groups].mean(axis=2)

    def _direct(self, points: SurfacePoints) -> Float[np.ndarray, "N P C"]:
        lit = direct_irradiance(self.tracer, points, self.emitters, self.shadow_rays)
        return np.ascontiguousarray(lit[..., : self.channels])


@jax.jit
def _combine(first: Array, second: Array) -> tuple[Array, Array]:
    """The mean of two estimates, and per lighting the sums of squares of half their difference and of the mean."""
    mean = 0.5 * (first + second)
    return mean, jnp.stack(
        [jnp.sum(jnp.square(part.astype(float)), axis=(1, 2)) for part in (0.5 * (first - second), mean)]
    )
