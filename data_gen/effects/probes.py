"""Probes: irradiance at a grid of points in the air, by the gather operator that lights the scene, for whatever moves there.

Each probe is a few receivers at one place that face all ways, with rows of their own in a hit table. So what reaches them is
one more range of receivers under the same lightings: bounces, media, noise and every method that maps direct to indirect light
go on as they are, and `Probes.volume` makes coefficients of what they give. A scene that is not asked for probes traces none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from data_gen.atlas import unwrap
from data_gen.decisions import Plan
from data_gen.gather import NOWHERE, trace_hits
from data_gen.gather import buried as buried_points
from data_gen.light import LightPass, Received
from data_gen.plan import plan
from data_gen.resolve import HitResolver
from data_gen.scenarios import check_lightings
from data_gen.trace import CHUNK
from data_gen.tracer import Tracer
from prt_bench.dataset import LightingDataset, Transport
from prt_bench.errors import SpecError
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.irradiance_volume import ProbeVolume, normals, places
from prt_bench.lights import Lighting, emitters
from prt_bench.points import Lightmap, SurfacePoints
from prt_bench.scene import Scene
from prt_bench.spherical.harmonics import quadrature
from prt_bench.walks import WalkTable

_LOOKS = 10
"""Degree of the directions in which a probe looks around."""


@dataclass(frozen=True, eq=False)
class Probes:
    """Traced probes of a baked scene. `transport` is the scene's, with the probes' receivers, J for each probe in turn."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    shape: tuple[int, int, int]
    buried: Bool[np.ndarray, " P"]
    transport: Transport
    settings: Plan
    tracer: Tracer

    def volume(self, irradiance: Float[Array, "N P*J C"] | Float[np.ndarray, "N P*J C"]) -> ProbeVolume:
        """The irradiance volume of what the probes' receivers get, simulated or predicted, W/m²; linear in it."""
        values = jnp.asarray(irradiance).reshape(len(irradiance), len(self.buried), -1, irradiance.shape[2])
        coefficients = jnp.einsum("kj,npjc->npkc", jnp.asarray(normals()[1], values.dtype), values)
        box = (jnp.asarray(self.low, values.dtype), jnp.asarray(self.high, values.dtype))
        return ProbeVolume(*box, jnp.asarray(self.buried), coefficients, self.shape)

    def light(self, lightings: Sequence[Lighting]) -> ProbeVolume:
        """The volume of indirect light under lightings. Raises `LightError` for lights inside the geometry."""
        check_lightings(self.transport.scene, tuple(lightings), self.tracer)
        return self.volume(np.concatenate([part.indirect for part in self._lit(lightings)], axis=1))

    def dataset(self, ds: LightingDataset) -> LightingDataset:
        """The lightings of `ds` with light at the probes' receivers in the place of the lightmap, in memory: what a method is
        fitted to that is to predict probes from the same measured light."""
        parts = self._lit(ds.all_lightings)
        squares = np.sum([part.squares for part in parts], axis=0)
        held_out = ds.metadata["held_out"]
        arrays = {
            "measured": np.asarray(ds.arrays["measured"][...]),
            "direct": np.concatenate([part.direct for part in parts], axis=1),
            "indirect": np.concatenate([part.indirect for part in parts], axis=1),
            "indirect_half": np.concatenate([part.half for part in parts], axis=1)[held_out:],
            "noise": np.sqrt(np.divide(*squares, out=np.zeros_like(squares[0]), where=squares[1] > 0)),
        }
        return replace(ds, transport=self.transport, arrays=arrays, path=None)

    def _lit(self, lightings: Sequence[Lighting]) -> list[Received]:
        passes = LightPass(self.transport, self.tracer, emitters(lightings), self.settings)
        count = len(self.transport.receivers)
        return [passes.receive(slice(at, at + CHUNK)) for at in range(0, count, CHUNK)]


def probes(
    ds: LightingDataset,
    shape: tuple[int, int, int] = (8, 8, 8),
    rays: int = 64,
    seed: int = 0,
    workers: int | None = None,
) -> Probes:
    """Trace a grid of `shape` probes in the box of a baked scene, `rays` for each of the directions that a probe faces.

    Same result for any number of workers. Raises `SpecError` for an empty grid or an odd number of rays.
    """
    if len(shape) != 3 or min(shape) < 1:
        raise SpecError(f"a grid of {shape} probes has none; give three numbers from 1 up")
    if rays < 2 or rays % 2:
        raise SpecError(f"rays is {rays}, but must be an even number from 2 up: the two halves measure the noise")
    scene, transport, tracer = ds.scene, ds.transport, Tracer(ds.scene, workers)
    low, high = scene.bounds
    facing, _ = normals()
    place = places(low, high, shape)
    hidden = _behind(scene, tracer, place)
    count = len(place) * len(facing)
    points = SurfacePoints(
        np.repeat(place, len(facing), axis=0), np.tile(facing, (len(place), 1)), np.zeros((count, 3)),
        np.full(count, NOWHERE), np.zeros((count, 3)),
    )  # fmt: skip
    dark = buried_points(tracer, transport.samples, int(seed))
    resolver = HitResolver.create(scene.mesh, _gather_lightmap(ds), transport.samples, dark)
    sampler = HemisphereSampler.create(rays, seed)
    hits = trace_hits(tracer, resolver, sampler, points, 0)
    walks = transport.walks
    if walks is not None:  # the air lets light through, so nothing leaves there
        none = np.zeros(0, np.int32)
        table = WalkTable(none, none, np.zeros((0, *walks.samples.ends.shape[1:]), np.int32))
        walks = walks._replace(receivers=table, vertices=None)
    aired = replace(
        transport, receivers=points, buried=np.repeat(hidden, len(facing)), receiver_hits=hits,
        sampler=sampler, vertices=None, nodes=None, walks=walks,
    )  # fmt: skip
    known = {name: ds.metadata[name] for name in ("texels", "rays", "tolerance")}
    # A lone convex body shadows what flies round it, though not itself.
    settings = plan(scene, **known, force=(*ds.metadata.get("force", ()), "shadow rays"), workers=workers)
    return Probes(np.asarray(low), np.asarray(high), shape, hidden, aired, settings, tracer)


def _behind(scene: Scene, tracer: Tracer, place: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    """Which places are within bodies or beyond walls: they see more of the backs of surfaces than of their fronts."""
    directions, _ = quadrature(_LOOKS)
    hits = tracer.intersect(np.repeat(place, len(directions), axis=0), np.tile(directions, (len(place), 1)))
    met = hits.face >= 0
    front = hits.front | np.array([material.two_sided for material in scene.materials])[scene.mesh.material[hits.face]]
    fronts, backs = (part.reshape(len(place), -1).sum(axis=1) for part in (met & front, met & ~front))
    return backs > fronts


def _gather_lightmap(ds: LightingDataset) -> Lightmap:
    """Where the gather samples of a dataset lie. Raises `SpecError` where another pose's coarser charts would be needed."""
    side = ds.metadata["gather_texels"]
    if side == ds.metadata["texels"]:
        return ds.lightmap
    if "layout" in ds.metadata:
        raise SpecError(
            f"probes of a pose need gather samples as fine as its texels; bake '{ds.scene.name}' with as many"
        )
    return unwrap(ds.scene, side, None if ds.path is None else ds.path.parent)
