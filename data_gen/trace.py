"""Tracing a scene once: unwrap, shoot, resolve, and store the hit tables under a hash of all they depend on."""

from pathlib import Path

import numpy as np
import zarr
from jaxtyping import Float

from data_gen.atlas import lightmap_points, unwrap
from data_gen.decisions import Plan
from data_gen.effects.hair import VERSION as HAIR_VERSION
from data_gen.effects.hair import write_strand_paths
from data_gen.effects.subsurface import VERSION as WALKS_VERSION
from data_gen.effects.subsurface import WalkTracer, write_walks
from data_gen.gather import buried, trace_hits
from data_gen.journal import content_key, create_array, resumable
from data_gen.nodes import Interpolation, Looker, interpolate
from data_gen.resolve import HitResolver
from data_gen.strand_atlas import points_with_strands, unwrap_with_strands
from data_gen.tracer import Tracer
from data_gen.vertices import shading_vertices
from prt_bench.dataset import Transport
from prt_bench.errors import SpecError
from prt_bench.hemisphere import SAMPLER, HemisphereSampler
from prt_bench.points import SurfacePoints
from prt_bench.progress import track
from prt_bench.scene import Scene
from prt_bench.store import FORMAT, write_array, write_lightmap, write_points, write_scene
from prt_bench.transport import GatherOperator, Scattering, tail_bounds
from prt_bench.walks import read_walks

CHUNK = 1 << 14
"""Receivers that are traced, lit and stored together."""
_VERSION = 3  # raise when the same inputs would give other hits


def transport_key(scene: Scene, settings: Plan, seed: int, layout: Transport | None = None) -> str:
    """A short hash of everything that the hit tables depend on."""
    return content_key(
        {
            **({} if layout is None else {"layout": layout.key}),
            "version": _VERSION,
            "format": FORMAT,
            "scene": scene.hash,
            "texels": settings.texels,
            "gather_texels": settings.gather_texels,
            "rays": settings.rays,
            "tolerance": settings.tolerance,
            "effects": settings.effects,
            **({"walks": WALKS_VERSION} if "subsurface" in settings.effects else {}),
            **({"hair": HAIR_VERSION} if scene.strands is not None else {}),
            **({"vertices": True} if settings.vertices else {}),
            **({"nodes": [settings.node_rays, settings.node_tolerance]} if settings.node_rays else {}),
            **({"mips": settings.mips} if settings.mips else {}),
            **({"texture_set": True} if settings.texture_set else {}),
            **({"bounces": "all"} if "bounces" in settings.force else {}),
            "seed": seed,
        }
    )


def trace(
    scene: Scene, settings: Plan, seed: int, folder: Path, tracer: Tracer, layout: Transport | None = None
) -> Transport:
    """Trace the hit tables of a scene once, or open them when they are there already.

    `layout` is the transport of another pose of the same mesh: its atlas serves, so that a texel stays on its face.
    """
    key = transport_key(scene, settings, seed, layout)
    path = folder / f"transport-{scene.name}-{key}.zarr"
    if path.is_dir():
        return Transport.open(path)
    chosen = (settings.mips, settings.texture_set)
    charted, pointed = (unwrap, lightmap_points)
    if scene.strands is not None:
        charted, pointed = (unwrap_with_strands, points_with_strands)
    lightmap = charted(scene, settings.texels, folder, *chosen) if layout is None else layout.lightmap
    receivers = pointed(scene, lightmap)
    shared = settings.gather_texels == settings.texels
    home = scene if layout is None else layout.scene
    gather_map = lightmap if shared else unwrap(home, settings.gather_texels, folder)
    samples = receivers if shared else lightmap_points(scene, gather_map)
    hidden = buried(tracer, receivers, seed)
    if receivers.clearance is not None:
        hidden &= receivers.clearance == 0  # the axis of a strand lies in its own tube
    resolver = HitResolver.create(scene.mesh, gather_map, samples, hidden if shared else buried(tracer, samples, seed))
    sampler = HemisphereSampler.create(settings.rays, seed)

    vertices, corner = shading_vertices(scene) if settings.vertices else (None, None)
    tables = [] if settings.node_rays else [("receiver_hits", receivers)]
    tables += [] if shared else [("sample_hits", samples)]
    tables += [] if vertices is None else [("vertex_hits", vertices)]
    chunks = [(name, points, slice(at, at + CHUNK)) for name, points in tables for at in range(0, len(points), CHUNK)]
    needed = sum(len(points) for _, points in tables) * settings.rays * resolver.sample.dtype.itemsize
    needed += len(receivers) * settings.node_rays // 2 * resolver.sample.dtype.itemsize
    with resumable(path, int(1.1 * needed)) as (partial, journal):
        group = zarr.open_group(partial, mode="a")
        for name, points in tables:
            shape, chunk = (len(points), settings.rays), (min(CHUNK, len(points)), settings.rays)
            create_array(group, name, shape, chunk, resolver.sample.dtype)
        missing = [(index, chunk) for index, chunk in enumerate(chunks) if index not in journal.done]
        for index, (name, points, rows) in track(missing, f"trace {scene.name}"):
            group[name][rows] = _traced(tracer, resolver, sampler, points[rows], rows.start)
            journal.add(index)
        if settings.node_rays and len(chunks) not in journal.done:
            directions = HemisphereSampler.create(settings.node_rays, seed)
            hits = _grown(group, settings.node_rays, resolver)
            look = Looker(tracer, resolver, directions, receivers, samples, hits)
            found = interpolate(lightmap, receivers, hidden, settings.node_tolerance, look)
            _write_nodes(group, found, receivers, directions)
            journal.add(len(chunks))
        if "subsurface" in settings.effects:
            kinds = {"receivers": receivers, "samples": None if shared else samples, "vertices": vertices}
            from_points = {name: points for name, points in kinds.items() if points is not None}
            walker = WalkTracer(scene, gather_map, samples, sampler, tracer.workers)
            write_walks(group, journal, len(chunks) + 1, walker, from_points)
            tracer.nearest += sum(body.tracer.nearest for body in walker.bodies.values())
        if scene.strands is not None:
            walks = read_walks(group, scene) if scene.translucent else None
            later = len(chunks) + 1 + len(receivers)
            through = walks and walks.samples
            write_strand_paths(group, journal, later, scene, tracer, gather_map, samples, settings.rays, seed, through)
        write_scene(group, scene)
        write_lightmap(group, "lightmap", lightmap)
        write_points(group, "receivers", receivers)
        write_array(group, "buried", hidden)
        write_points(group, "samples", samples)
        if vertices is not None:
            write_points(group, "vertices", vertices)
            write_array(group, "corner", corner)
        _write_sampler(group, sampler)
        sample_hits = "receiver_hits" if shared else "sample_hits"
        gather = GatherOperator.from_hits(np.asarray(group[sample_hits][...]), len(samples))
        walks = read_walks(group, scene)
        scattering = walks and walks.samples.scattering(len(samples), walks.colour)
        group.attrs.update(
            {
                "kind": "transport",
                "format": FORMAT,
                "key": key,
                "sample_hits": sample_hits,
                "seed": seed,
                "bounces": needed_bounces(gather, samples.albedo, settings, scene.name, scattering),
            }
        )
    return Transport.open(path)


def _traced(
    tracer: Tracer, resolver: HitResolver, sampler: HemisphereSampler, points: SurfacePoints, first: int
) -> np.ndarray:
    """Hit table rows of points. Those on strands, which come last, have none: their light comes along paths of their own."""
    if points.clearance is None:
        return trace_hits(tracer, resolver, sampler, points, first)
    table = np.full((len(points), sampler.local.shape[1]), resolver.samples, resolver.sample.dtype)
    surfaces = int(np.sum(points.clearance == 0))
    if surfaces:
        table[:surfaces] = trace_hits(tracer, resolver, sampler, points[:surfaces], first)
    return table


def _grown(group: zarr.Group, rays: int, resolver: HitResolver) -> zarr.Array:
    """The hit table of the nodes, begun anew: it grows as they are found."""
    if "receiver_hits" in group:
        del group["receiver_hits"]
    return create_array(group, "receiver_hits", (0, rays), (1024, rays), resolver.sample.dtype)


def _write_sampler(group: zarr.Group, sampler: HemisphereSampler) -> None:
    for name, array in zip(SAMPLER, (sampler.local, np.stack(sampler.jitter)), strict=True):
        write_array(group, name, np.asarray(array))


def _write_nodes(group: zarr.Group, found: Interpolation, receivers: SurfacePoints, sampler: HemisphereSampler) -> None:
    child = group.require_group("nodes")
    write_points(group, "nodes", receivers[found.nodes])
    _write_sampler(child, sampler)
    child.attrs["seed"] = sampler.seed
    for name, array in (("corner", found.corner.astype(np.int32)), ("weight", found.weight)):
        write_array(child, name, array)


def needed_bounces(
    gather: GatherOperator, albedo: Float[np.ndarray, "S C"], settings: Plan, name: str, scattering: Scattering | None
) -> int:
    """The planner's bound, lowered to what the traced operator needs for the same tolerance.

    Where all bounces are forced, the float32 sums may never fall that low: then as many as the planner allows.
    """
    bounds = tail_bounds(gather, albedo.astype(np.float32), settings.bounces, scattering)
    enough = np.flatnonzero(bounds <= settings.tail)
    if not enough.size and (settings.bounces < 2 or bounds[-1] <= settings.tolerance):
        return settings.bounces
    if not enough.size:
        raise SpecError(
            f"{settings.bounces} bounces leave up to {bounds[-1]:.2g} of the light in '{name}';"
            " lower the largest albedo or raise the tolerance"
        )
    return int(enough[0]) + 1
