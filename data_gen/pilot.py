"""What cannot be read off a scene, measured on a part of the bake: rays per point for a noise, gather texels for an error.

Some receivers of the lightmap itself are traced and lit by lightings that the bake holds out. Everything is computed as the
bake does it, from the same random numbers, so choices are the same every time; nothing of it is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import jax.numpy as jnp
import numpy as np
import zarr
from jaxtyping import Bool, Float

from data_gen.atlas import lightmap_points, unwrap
from data_gen.decisions import Plan
from data_gen.direct import direct_irradiance
from data_gen.effects.subsurface import WalkTracer, write_walks
from data_gen.gather import buried, trace_hits
from data_gen.journal import Journal
from data_gen.light import LightPass
from data_gen.resolve import HitResolver
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.emitters import Emitters
from prt_bench.errors import SceneError, SpecError
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.lights import Lighting, emitters
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Scene
from prt_bench.transport import GatherOperator, final_gather
from prt_bench.walks import Walks, half_columns, read_walks

MOST_RAYS = 1 << 12
"""Rays per point above which a noise is refused: hit tables grow with them."""
LEAST_RAYS = 1 << 4
LEAST_GATHER = 16
MOST_GATHER = 512
"""Texels a side of the finest gather lightmap that coarser ones are compared with."""
_RECEIVERS = 1 << 10
_SAMPLE_RAYS = 32  # of gather samples: their noise averages out over the rays of a receiver
_BOUNCES = 16
_TEXEL_RAYS = 1024
_TEXEL_LIGHTINGS = 8


@dataclass(frozen=True)
class Pilot:
    """Some receivers of a bake that `settings` describe, under `lightings` that it holds out."""

    scene: Scene
    settings: Plan
    lightings: Sequence[Lighting]
    seed: int
    folder: Path
    tracer: Tracer

    def rays(self, noise: float) -> tuple[int, list[tuple[int, float]]]:
        """How many rays per point, a power of two, leave no more than `noise` between their halves, and what was measured.

        `noise` is that of `LightingDataset.noise_floor`. What few rays leave tells how many to try; from there on they double.
        Raises `SpecError` where `MOST_RAYS` do not suffice.
        """
        found = [(LEAST_RAYS, self.noise(LEAST_RAYS))]
        while found[-1][1] > noise:
            count = 4 * LEAST_RAYS if len(found) == 1 else 2 * found[-1][0]
            if len(found) == 2:
                (few, coarse), (more, fine) = found
                slope = np.clip(np.log(coarse / fine) / np.log(more / few), 0.5, 1.0)
                count = max(count, 1 << int(np.log2(more * (fine / noise) ** (1.0 / slope))))
            if count > MOST_RAYS:
                raise unattainable(self.scene, noise, *found[-1])
            found.append((count, self.noise(count)))
        return found[-1][0], found

    def gather_texels(self, tolerance: float) -> tuple[int, float]:
        """Side of the coarsest gather lightmap that carries light bounced once, and its error, at most `tolerance`.

        The error is the relative RMSE of that light at the receivers (`relative_bias`), against a lightmap as fine as theirs
        (at most `MOST_GATHER`). Where none suffices, the receivers' own side is given, with no error.
        """
        lit = emitters(self.lightings[:_TEXEL_LIGHTINGS])
        finest = min(self.settings.texels, MOST_GATHER)
        reference = self._bounced_once(unwrap(self.scene, finest, self.folder), lit)
        side = LEAST_GATHER
        while side < finest:
            try:
                lightmap = unwrap(self.scene, side, self.folder)
            except SceneError:  # charts that do not fit
                lightmap = None
            if lightmap is not None:
                first, second = self._bounced_once(lightmap, lit) - reference
                error = relative_bias(first, second, reference.mean(axis=0))
                if error <= tolerance:
                    return side, error
            side *= 2
        return self.settings.texels, 0.0

    def noise(self, rays: int) -> float:
        """What `LightingDataset.noise_floor` would be with so many rays per point, from these receivers."""
        passes = self._passes
        receivers, chosen = self._receivers
        sampler = HemisphereSampler.create(rays, self.seed)
        walks = passes.transport.walks
        passes.transport = replace(
            passes.transport,
            receiver_hits=trace_hits(self.tracer, self._resolver, sampler, receivers, chosen),
            walks=walks and walks._replace(receivers=self._walked(receivers, sampler).receivers),
        )
        noise, signal = passes.receive(slice(None)).squares
        lit = signal > 0
        return float(np.sqrt(np.mean(noise[lit] / signal[lit]))) if lit.any() else 0.0

    @cached_property
    def _passes(self) -> LightPass:
        """Light at the gather samples, from few rays; receivers are put in for each number of rays."""
        receivers, _ = self._receivers
        samples = self._gathered[1]
        sampler = HemisphereSampler.create(_SAMPLE_RAYS, self.seed)
        hits = trace_hits(self.tracer, self._resolver, sampler, samples, 0)
        walks = self._walked(samples, sampler) if "subsurface" in self.settings.effects else None
        bounces = min(self.settings.bounces, _BOUNCES)
        dark = np.zeros(len(receivers), bool)
        transport = Transport(
            self.scene, self._lightmap, receivers, dark, samples, hits, hits, bounces, "", sampler,
            walks=walks and walks._replace(samples=walks.receivers or walks.samples),
        )  # fmt: skip
        return LightPass(transport, self.tracer, emitters(self.lightings), self.settings)

    def _walked(self, points: SurfacePoints, sampler: HemisphereSampler) -> Walks:
        """Walks from the translucent ones of some points, in memory."""
        lightmap, samples, _ = self._gathered
        walker = WalkTracer(self.scene, lightmap, samples, sampler, self.tracer.workers)
        with TemporaryDirectory() as folder:
            group = zarr.open_group(Path(folder) / "walks.zarr", mode="a")
            write_walks(group, Journal(Path(folder)), 0, walker, {"receivers": points})
            walks = read_walks(group, self.scene)
            assert walks is not None
            table = walks.samples._replace(ends=np.asarray(walks.samples.ends[...]))
        return walks._replace(receivers=table, samples=table)

    def _bounced_once(self, lightmap: Lightmap, lit: Emitters) -> Float[np.ndarray, "2 N P C"]:
        """Irradiance at the receivers from direct light that samples of `lightmap` reflect, by half of the rays, W/m²."""
        receivers, chosen = self._receivers
        samples = lightmap_points(self.scene, lightmap)
        resolver = HitResolver.create(self.scene.mesh, lightmap, samples, self._buried(samples))
        sampler = HemisphereSampler.create(_TEXEL_RAYS, self.seed)
        hits = trace_hits(self.tracer, resolver, sampler, receivers, chosen)
        direct = direct_irradiance(self.tracer, samples, lit, self.settings.needs_shadow_rays(self.scene, lit))
        reflected = jnp.moveaxis(jnp.asarray(direct * samples.albedo, jnp.float32), 0, 1)
        halves = (hits[:, half_columns(_TEXEL_RAYS, half)] for half in (0, 1))
        gathers = [GatherOperator.from_hits(half, len(samples)) for half in halves]
        return np.stack([np.asarray(final_gather(gather, reflected)) for gather in gathers])

    @cached_property
    def _lightmap(self) -> Lightmap:
        return unwrap(self.scene, self.settings.texels, self.folder, self.settings.mips, self.settings.texture_set)

    @cached_property
    def _receivers(self) -> tuple[SurfacePoints, np.ndarray]:
        """Receivers of the bake, evenly among all, and their indices."""
        points = lightmap_points(self.scene, self._lightmap)
        chosen = np.unique(np.linspace(0, len(points) - 1, min(_RECEIVERS, len(points))).astype(np.int64))
        return points[chosen], chosen

    @cached_property
    def _gathered(self) -> tuple[Lightmap, SurfacePoints, Bool[np.ndarray, " S"]]:
        """The gather lightmap, its samples, and which of them are buried."""
        shared = self.settings.gather_texels == self.settings.texels
        lightmap = self._lightmap if shared else unwrap(self.scene, self.settings.gather_texels, self.folder)
        samples = lightmap_points(self.scene, lightmap)
        return lightmap, samples, self._buried(samples)

    @cached_property
    def _resolver(self) -> HitResolver:
        return HitResolver.create(self.scene.mesh, *self._gathered)

    def _buried(self, points: SurfacePoints) -> Bool[np.ndarray, " P"]:
        return buried(self.tracer, points, self.seed)


def unattainable(scene: Scene, noise: float, rays: int, left: float) -> SpecError:
    """Why no number of rays is enough."""
    return SpecError(
        f"noise is {noise:g}, but {rays} rays per point leave {left:.2g} in '{scene.name}'; allow more noise, or give rays a"
        " number"
    )


def relative_bias(
    first: Float[np.ndarray, "N P C"], second: Float[np.ndarray, "N P C"], whole: Float[np.ndarray, "N P C"]
) -> float:
    """Root mean square over lightings of ‖difference‖ / ‖whole‖, less the noise of the difference; black ones are left out.

    `first` and `second` are the difference as each half of the rays has it. Their mean is its estimate d, half their difference
    its noise e, and E‖d‖² is the square of what is systematic plus E‖e‖².
    """
    mean, noise = 0.5 * (first + second), 0.5 * (first - second)
    found, error, light = (np.sum(np.square(part, dtype=np.float64), axis=(1, 2)) for part in (mean, noise, whole))
    lit = light > 0
    return float(np.sqrt(max(np.mean((found - error)[lit] / light[lit]), 0.0))) if lit.any() else 0.0
