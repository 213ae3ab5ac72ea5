"""What the planner left out of a bake, what that saved, and what it changed, measured against the full simulation.

A baked scene is lit again by some of its held-out lightings, as planned and with one thing after another simulated in full on
the same rays. So the differences are those of the decision alone; where it is about the rays, they are traced anew.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from data_gen.decisions import FORCIBLE, Plan
from data_gen.light import LightPass
from data_gen.pilot import relative_bias
from data_gen.plan import plan
from data_gen.trace import CHUNK, needed_bounces, trace
from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import SpecError
from prt_bench.lights import Lighting, emitters
from prt_bench.walks import no_walks

ROUNDING = 1e-6
"""Tolerance of what changes nothing: float32 sums of the same terms."""
LARGEST, RELATIVE = "largest, over the brightest direct light", "relative RMSE of indirect light, less noise"
_SETTINGS = ("texels", "rays", "tolerance", "gather_texels", "node_rays", "node_tolerance", "mips", "texture_set")


@dataclass(frozen=True)
class Skip:
    """Something that was left out: as `planned`, in `full`, and the `error` of that by `measure`, at most `tolerance`.

    `seconds` of lighting, shadow or gather `rays` and `bytes` on disk are what it saved for the whole bake, counted up from
    the lightings that were lit; below 0 where it took more.
    """

    name: str
    planned: str
    full: str
    error: float
    tolerance: float
    measure: str
    seconds: float
    rays: int
    bytes: int


class _Lit(NamedTuple):
    """Light of some lightings, indirect also by each half of the rays, seconds it took, and shadow rays."""

    direct: Float[np.ndarray, "N T C"]
    indirect: Float[np.ndarray, "N T C"]
    halves: tuple[Float[np.ndarray, "N T C"], Float[np.ndarray, "N T C"]]
    seconds: float
    shadow_rays: int


def skips(ds: LightingDataset, lightings: int = 8, workers: int | None = None, timed: bool = True) -> list[Skip]:
    """What the plan of a dataset left out, in the order of `FORCIBLE`, measured on so many of its test lightings.

    Everything is lit three times where it is `timed`, and the faster of the last two counts; otherwise no seconds are given.
    Gather samples and receivers in full are traced in a temporary folder. Raises `SpecError` without lightings.
    """
    if lightings < 1:
        raise SpecError(f"skips are measured on {lightings} lightings, but it takes at least 1")
    lights = ds.split("test").lightings[:lightings]
    known = {name: ds.metadata[name] for name in _SETTINGS if name in ds.metadata}
    full = plan(ds.scene, **known, force=FORCIBLE, workers=workers)
    planned = _as_baked(full, ds)
    tracer = Tracer(ds.scene, workers)
    base = _lit(ds.transport, planned, lights, tracer, timed)
    share = len(ds.all_lightings) / len(lights)
    with TemporaryDirectory() as folder:
        return [
            _measured(ds, name, settings, transport, base, _lit(transport, settings, lights, tracer, timed), share)
            for name, settings, transport in _alternatives(ds, planned, full, Path(folder), tracer)
        ]


def _as_baked(full: Plan, ds: LightingDataset) -> Plan:
    """The plan of a dataset, from that of everything in full."""
    force = tuple(ds.metadata.get("force", ()))
    channels = 1 if ds.scene.achromatic and "channels" not in force else 3
    own = {"gather_texels": ds.metadata["gather_texels"], "effects": tuple(ds.metadata["effects"])}
    own |= {name: ds.metadata[name] for name in ("node_rays", "node_tolerance") if name in ds.metadata}
    return replace(full, **own, channels=channels, force=force)


def _alternatives(
    ds: LightingDataset, planned: Plan, full: Plan, folder: Path, tracer: Tracer
) -> Iterator[tuple[str, Plan, Transport]]:
    """Each thing that was left out, the plan that does not, and its operator."""
    transport = ds.transport
    if "subsurface" not in planned.effects:
        walks = transport.walks or no_walks(planned.rays, len(ds.scene.materials))
        yield "subsurface", replace(planned, effects=full.effects), replace(transport, walks=walks)
    if planned.channels < full.channels:
        yield "channels", replace(planned, channels=full.channels), transport
    if "bounces" not in planned.force:
        settings = replace(planned, force=("bounces",), bounces=full.bounces)
        gather, scattering = transport.sample_gather(), transport.sample_scattering()
        bounces = needed_bounces(gather, transport.samples.albedo, settings, ds.scene.name, scattering)
        if bounces > transport.bounces:
            yield "bounces", settings, replace(transport, bounces=bounces)
    if planned.convex is not None and "shadow rays" not in planned.force:
        yield "shadow rays", replace(planned, force=("shadow rays",)), transport
    if planned.gather_texels < full.gather_texels and transport.nodes is None:
        settings = replace(planned, gather_texels=full.gather_texels)
        yield "gather samples", settings, trace(ds.scene, settings, int(ds.metadata["seed"]), folder, tracer)
    if planned.node_rays:
        settings = replace(planned, node_rays=0)
        yield "receivers", settings, trace(ds.scene, settings, int(ds.metadata["seed"]), folder, tracer)


def _measured(
    ds: LightingDataset, name: str, settings: Plan, transport: Transport, base: _Lit, full: _Lit, share: float
) -> Skip:
    texts = {
        "subsurface": ("not simulated", "walks from 0 points"),
        "channels": (str(base.indirect.shape[2]), str(full.indirect.shape[2])),
        "bounces": (str(ds.transport.bounces), str(transport.bounces)),
        "shadow rays": ("where none can be", "all"),
        "gather samples": tuple(f"{side}² texels" for side in (ds.metadata["gather_texels"], settings.gather_texels)),
        "receivers": (f"{ds.metadata.get('node_rays')} rays at nodes", f"{settings.rays} rays at all"),
    }
    tolerance = {
        "bounces": settings.tolerance,
        "gather samples": ds.metadata.get("gather_tolerance", 0.0),
        "receivers": ds.metadata.get("node_tolerance", 0.0),
    }
    smooth = name in ("gather samples", "receivers")
    wider = full.indirect.shape[2] / base.indirect.shape[2] - 1.0
    arrays = sum(ds.arrays[each].nbytes for each in ("direct", "indirect", "indirect_half", "measured"))
    rays = _gather_rays(transport) - _gather_rays(ds.transport) + share * (full.shadow_rays - base.shadow_rays)
    return Skip(
        name,
        *texts[name],
        error=_smooth(base, full) if smooth else largest(base, full),
        tolerance=tolerance.get(name, ROUNDING),
        measure=RELATIVE if smooth else LARGEST,
        seconds=share * (full.seconds - base.seconds),
        rays=round(rays),
        bytes=round(wider * arrays) + _table_bytes(transport) - _table_bytes(ds.transport),
    )


def _smooth(base: _Lit, full: _Lit) -> float:
    first, second = (one - other for one, other in zip(base.halves, full.halves, strict=True))
    return relative_bias(first, second, full.indirect)


def largest(base: _Lit, full: _Lit) -> float:
    """Largest difference of direct or indirect light at any receiver, over the brightest direct light of its lighting."""
    bright = full.direct.max(axis=(1, 2))
    apart = [
        np.abs(one - other).max(axis=(1, 2))
        for one, other in ((base.direct, full.direct), (base.indirect, full.indirect))
    ]
    worst = np.maximum(*apart)
    return float(np.max(np.divide(worst, bright, out=np.where(worst > 0, np.inf, 0.0), where=bright > 0)))


def _lit(transport: Transport, settings: Plan, lights: Sequence[Lighting], tracer: Tracer, timed: bool) -> _Lit:
    parts, seconds, rays = [], [], 0
    for _ in range(1 + 2 * timed):  # what is compiled on the first run is not counted
        started, before = time.perf_counter(), tracer.shadow
        passes = LightPass(transport, tracer, emitters(lights), settings)
        parts = [passes.receive(slice(at, at + CHUNK)) for at in range(0, len(transport.receivers), CHUNK)]
        seconds.append(time.perf_counter() - started)
        rays = tracer.shadow - before
    direct, indirect, half = (
        np.concatenate([getattr(part, name) for part in parts], axis=1) for name in ("direct", "indirect", "half")
    )
    return _Lit(direct, indirect, (half, 2.0 * indirect - half), min(seconds[1:], default=0.0), rays)


def _tables(transport: Transport) -> list[Any]:
    """Every table of a transport once."""
    shared = transport.sample_hits is transport.receiver_hits
    walks = [table.ends for table in (transport.walks or ())[:2] if table is not None]
    return [transport.receiver_hits, *([] if shared else [transport.sample_hits]), *walks]


def _table_bytes(transport: Transport) -> int:
    return sum(table.nbytes for table in _tables(transport))


def _gather_rays(transport: Transport) -> int:
    return sum(table.size for table in _tables(transport))
