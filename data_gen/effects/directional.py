"""Directional indirect light on glossy surfaces: the rays that were traced for irradiance, each weighted by nine harmonics.

No ray is traced for it: radiosity of the gather samples goes through the hit table of the receivers once more, with y_k of each
ray's direction as its weight. So all bounces, media and noise are those of the lightmap. Coefficients of a receiver stand one
after another as nine values that any method which learns from lightings alone can be fitted to. What they mean is in
`prt_bench.glossy_indirect`; a scene that is not asked for them computes none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from data_gen.light import LightPass
from data_gen.plan import plan
from data_gen.scenarios import check_lightings
from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import SpecError
from prt_bench.glossy_indirect import COEFFICIENTS, ORDER
from prt_bench.lights import Lighting, emitters
from prt_bench.spherical import evaluate
from prt_bench.walks import half_columns

_VALUES = 1 << 25  # of radiosity along rays in memory at once


@dataclass(frozen=True, eq=False)
class Directional:
    """Directional light of a baked scene at the receivers `rows` [G] that have a lobe."""

    ds: LightingDataset
    rows: Int[np.ndarray, " G"]
    tracer: Tracer

    def light(self, lightings: Sequence[Lighting]) -> Float[np.ndarray, "N G 9 C"]:
        """Coefficients under lightings, W/m². Raises `LightError` for lights inside the geometry."""
        check_lightings(self.ds.scene, tuple(lightings), self.tracer)
        return 0.5 * sum(self._halves(lightings))  # pyright: ignore[reportReturnType]

    def dataset(self) -> LightingDataset:
        """The lightings of the baked dataset with the G · 9 coefficients in the place of the lightmap, in memory.

        `direct` is zero there. The hit table cannot be read: methods that work through the operator raise `SpecError`.
        """
        ds, transport = self.ds, self.ds.transport
        halves = [part.reshape(len(part), -1, part.shape[-1]) for part in self._halves(ds.all_lightings)]
        mean, apart = 0.5 * (halves[0] + halves[1]), 0.5 * (halves[0] - halves[1])
        noise, signal = (np.sum(np.square(part, dtype=float), axis=(1, 2)) for part in (apart, mean))
        arrays = {
            "measured": np.asarray(ds.arrays["measured"][...]),
            "direct": np.zeros_like(mean),
            "indirect": mean,
            "indirect_half": halves[0][ds.metadata["held_out"] :],
            "noise": np.sqrt(np.divide(noise, signal, out=np.zeros_like(noise), where=signal > 0)),
        }
        each = np.repeat(self.rows, COEFFICIENTS)
        receivers, table = transport.receivers[each], _NoTable(ds.scene.name)
        aired = replace(
            transport, receivers=receivers, buried=transport.buried[each], receiver_hits=table, vertices=None,
        )  # fmt: skip
        return replace(ds, transport=aired, arrays=arrays, path=None)

    def coefficients(self, values: Float[np.ndarray, "N G*9 C"]) -> Float[np.ndarray, "N G 9 C"]:
        """Predictions for the dataset's receivers as coefficients."""
        return np.asarray(values).reshape(len(values), len(self.rows), COEFFICIENTS, -1)

    def _halves(self, lightings: Sequence[Lighting]) -> list[Float[np.ndarray, "N G 9 C"]]:
        """Estimates from each half of the rays."""
        ds, transport = self.ds, self.ds.transport
        known = {name: ds.metadata[name] for name in ("texels", "rays", "tolerance")}
        settings = plan(ds.scene, **known, force=tuple(ds.metadata.get("force", ())))
        passes = LightPass(transport, self.tracer, emitters(lightings), settings)
        return [_through(transport, self.rows, sent, half) for half, sent in enumerate(passes.sent)]


class _NoTable:
    """In the place of a hit table: light of a direction is no mean over rays."""

    def __init__(self, scene: str) -> None:
        self._scene = scene

    def __getattr__(self, name: str) -> NoReturn:
        self._refuse()

    def __getitem__(self, rows: Any) -> NoReturn:
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise SpecError(
            f"directional light of '{self._scene}' has no hit table of its own; fit a method that learns from lightings alone"
        )


def directional(ds: LightingDataset, workers: int | None = None) -> Directional:
    """Directional light at the receivers of a baked dataset whose material has a glossy lobe.

    Raises `SpecError` for a scene without lobes, and for bakes whose receivers were interpolated or that kept no directions.
    """
    transport = ds.transport
    specular, _ = ds.scene.glossy_at(transport.receivers.face, transport.receivers.barycentric)
    rows = np.flatnonzero(specular.any(axis=1) & ~transport.buried)
    if not rows.size:
        raise SpecError(f"no surface of '{ds.scene.name}' has a glossy lobe, so none needs light by direction")
    if transport.nodes is not None:
        raise SpecError(
            f"receivers of '{ds.scene.name}' were interpolated, which forgets directions; bake without node_rays"
        )
    if transport.sampler is None:
        raise SpecError(f"the bake of '{ds.scene.name}' kept no directions of its rays; bake it again")
    return Directional(ds, rows, Tracer(ds.scene, workers))


def _through(
    transport: Transport, rows: Int[np.ndarray, " G"], sent: Float[Array, "S N C"], half: int
) -> Float[np.ndarray, "N G 9 C"]:
    """Σ_r B(hit_r) y_k(ω_r) / R of one half of the rays, some receivers at a time."""
    assert transport.sampler is not None
    count, channels = sent.shape[1:]
    padded = jnp.concatenate([sent.reshape(len(sent), -1), jnp.zeros((2, count * channels), sent.dtype)])
    columns = half_columns(transport.receiver_hits.shape[1], half)
    rays = transport.receiver_hits.shape[1] // 2
    size = max(_VALUES // (rays * count * channels), 1)
    out = np.empty((len(rows), COEFFICIENTS, count * channels), np.float32)
    for at in range(0, len(rows), size):
        some = rows[at : at + size]
        block = slice(int(some[0]), int(some[-1]) + 1)
        hits = np.asarray(transport.receiver_hits[block, columns])[some - some[0]]
        towards = transport.sampler.directions(some, transport.receivers.normal[some])[:, columns]
        pad = ((0, size - len(some)), (0, 0))
        hits, towards = np.pad(hits, pad, constant_values=len(sent)), np.pad(towards, (*pad, (0, 0)), mode="edge")
        out[at : at + size] = _weighted(padded, jnp.asarray(hits), jnp.asarray(towards))[: len(some)]
    return np.moveaxis(out.reshape(len(rows), COEFFICIENTS, count, channels), 2, 0)


@jax.jit
def _weighted(padded: Array, hits: Array, towards: Array) -> Array:
    harmonics = evaluate(towards, ORDER) / hits.shape[1]
    return jnp.einsum("grk,grn->gkn", harmonics.astype(padded.dtype), padded[hits])
