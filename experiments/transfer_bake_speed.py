"""How long a large bake of classical transfer vectors takes, and how much memory, noise and bias it has.

Traces the scene as `prt.bake` does with `node_rays`: many rays at nodes of the lightmap, few at the gather samples, and
everything between nodes interpolated where it is smooth. Then it collects the direct transfer vectors from the rays that
escape and sends those at the gather samples through all bounces: what `sh-texture` ships. Goal: an order-5 texture of 1024²
texels in 4 minutes on two cores, with at most 1 % of noise and of bias; the source paper names about 3 hours.

Noise comes from two textures T_a and T_b of half of the rays each, which share nothing but the surface: ‖T_a − T_b‖ / 2‖T‖
over all texels, channels and coefficients. Error is measured against texels drawn at random and traced one by one, with many
rays of other directions; it holds the noise as well as what interpolation misses, and what is left of it without the noise
of both is called bias. Radiosity at the gather samples is the bake's own on both sides.

    python experiments/transfer_bake_speed.py [--scene room] [--texels 1024] [--order 5] [--rays 512] [--node_rays 2048]
        [--tolerance 0.02] [--checked 2000] [--out DIR]

`--node_rays 0` traces every texel with `--rays`.
"""

import argparse
import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import prt_bench as prt
from data_gen.atlas import lightmap_points, unwrap
from data_gen.decisions import Plan
from data_gen.gather import buried, trace_hits
from data_gen.plan import plan
from data_gen.resolve import HitResolver
from data_gen.trace import trace
from data_gen.tracer import Tracer
from prt_bench.dataset import Nodes, Transport
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.methods.escaping import direct_transfer
from prt_bench.methods.operator import respond

MINUTES, GOAL = 4.0, 0.01
CHECKED_RAYS = 1 << 14
Seconds = dict[str, np.ndarray]
"""Wall and CPU seconds by stage."""


class Vectors(NamedTuple):
    """Direct [T, 1, K] and indirect [T, C, K] transfer vectors."""

    direct: np.ndarray
    indirect: np.ndarray

    @property
    def all(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Direct, indirect and their sum, float32."""
        return self.direct, self.indirect, self.direct + self.indirect


class Baked(NamedTuple):
    """A bake of transfer vectors, and what it was made with."""

    settings: Plan
    transport: Transport
    vectors: Vectors


@contextmanager
def timed(seconds: Seconds, name: str) -> Iterator[None]:
    """Note how long a stage takes."""
    started = np.array([time.perf_counter(), time.process_time()])
    yield
    seconds[name] = np.array([time.perf_counter(), time.process_time()]) - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="room")
    parser.add_argument("--texels", type=int, default=1024)
    parser.add_argument("--order", type=int, default=5)
    parser.add_argument("--rays", type=int, default=512, help="per gather sample, and per texel without nodes")
    parser.add_argument("--node_rays", type=int, default=2048, help="per node; 0 traces every texel")
    parser.add_argument("--tolerance", type=float, default=0.02, help="of interpolation between nodes")
    parser.add_argument("--checked", type=int, default=2000, help="texels traced one by one, to compare with")
    parser.add_argument("--out", type=Path, help="where hit tables are kept; without it they are thrown away")
    settings = parser.parse_args()
    with TemporaryDirectory() as folder:
        where = settings.out or Path(folder)
        seconds: Seconds = {}
        load = os.getloadavg()[0]
        baked = collect(settings, where, seconds)
        report(settings, baked, seconds, load)
        print(f"noise   {describe(split_half(baked, settings.order))}; goal {GOAL:.0%}", flush=True)
        compare(baked, settings.order, settings.checked, where)


def collect(settings: argparse.Namespace, folder: Path, seconds: Seconds) -> Baked:
    """What a bake of transfer vectors consists of, each step timed."""
    with timed(seconds, "plan"):
        loaded = prt.load_scene(settings.scene)
        nodes = {"node_rays": settings.node_rays, "node_tolerance": settings.tolerance}
        planned = plan(loaded, "environment", texels=settings.texels, rays=settings.rays, **nodes)
    with timed(seconds, "unwrap, trace, resolve"):
        transport = trace(loaded, planned, 0, folder, Tracer(loaded))
    return Baked(planned, transport, vectors_of(transport, settings.order, seconds))


def vectors_of(transport: Transport, order: int, seconds: Seconds) -> Vectors:
    """Transfer vectors at all receivers."""
    traced = transport.traced
    with timed(seconds, "direct transfer"):
        direct = transport.spread(direct_transfer(traced, traced.receiver_hits, traced.receivers, order))
    with timed(seconds, "direct transfer at the gather samples"):
        at_samples = direct_transfer(transport, transport.sample_hits, transport.samples, order)
    with timed(seconds, "inter-reflections"):
        indirect = respond(transport, albedo(transport), at_samples)
    return Vectors(direct[:, None], indirect)


def albedo(transport: Transport) -> jnp.ndarray:
    """Of the gather samples, in as many channels as the scene has."""
    return jnp.asarray(transport.samples.albedo[:, : 1 if transport.scene.achromatic else 3], jnp.float32)


def report(settings: argparse.Namespace, baked: Baked, seconds: Seconds, load: float) -> None:
    """Print seconds and memory of one bake."""
    transport, memory = baked.transport, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    traced, samples = transport.receiver_hits, transport.sample_hits
    print(
        f"{settings.scene}: {len(transport.receivers)} of {settings.texels}² texels, {traced.shape[0]} of them traced with"
        f" {traced.shape[1]} rays; {samples.shape[0]} gather samples with {samples.shape[1]}; order {settings.order},"
        f" {transport.bounces} bounces, {baked.vectors.indirect.shape[1]} channels,"
        f" {len(transport.scene.mesh.faces)} triangles"
    )
    for name, (wall, cpu) in seconds.items():
        print(f"  {name:38} {wall:8.1f} s wall, {cpu:8.1f} s CPU")
    wall, cpu = np.sum(list(seconds.values()), axis=0)
    print(f"bake    {wall:8.1f} s wall, {cpu:.1f} s CPU; goal {60 * MINUTES:.0f} s")
    print(f"load    {load:8.1f} before, on {os.cpu_count()} cores")
    print(f"memory  {memory / 1e9:8.2f} GB peak", flush=True)


def split_half(baked: Baked, order: int) -> tuple[float, ...]:
    """Noise of direct and indirect transfer and of their sum, from the two halves of the rays."""
    halves = [vectors_of(halved(baked.transport, half), order, {}) for half in (0, 1)]
    wholes = zip(*(part.all for part in (baked.vectors, *halves)), strict=True)
    return tuple(float(np.linalg.norm(a - b) / (2.0 * np.linalg.norm(whole))) for whole, a, b in wholes)


def halved(transport: Transport, half: int, bounces: bool = True) -> Transport:
    """The same with one half of the rays alone: in every bounce, or in the last."""

    def part(count: int) -> slice:
        return slice(half * count // 2, (half + 1) * count // 2)

    def fewer(sampler: HemisphereSampler | None) -> HemisphereSampler:
        assert sampler is not None
        chosen = part(sampler.local.shape[1])
        return HemisphereSampler.stored(
            np.asarray(sampler.local)[:, chosen], np.stack(sampler.jitter)[:, :, chosen], sampler.seed
        )

    nodes = transport.nodes
    last = replace(
        transport,
        receiver_hits=np.asarray(transport.receiver_hits[:, part(transport.receiver_hits.shape[1])]),
        nodes=nodes and nodes._replace(sampler=fewer(nodes.sampler)),
    )
    if nodes is not None and not bounces:
        return last
    sample_hits = np.asarray(transport.sample_hits[:, part(transport.sample_hits.shape[1])])
    return replace(last, sample_hits=sample_hits, sampler=fewer(transport.sampler))


def compare(baked: Baked, order: int, count: int, folder: Path) -> None:
    """Print how far random texels are from the same texels traced one by one."""
    transport = baked.transport
    chosen = np.sort(np.random.default_rng(0).permutation(len(transport.receivers))[:count])
    alone = traced_alone(baked, chosen, folder)
    wanted = vectors_of(alone, order, {})
    ours = [Vectors(*(part[chosen] for part in baked.vectors))]
    ours += [
        Vectors(*(part[chosen] for part in vectors_of(halved(transport, half, bounces=False), order, {})))
        for half in (0, 1)
    ]
    halves = [vectors_of(halved(alone, half, bounces=False), order, {}) for half in (0, 1)]
    columns = zip(*(part.all for part in (*ours, wanted, *halves)), strict=True)
    errors, biases, noises = [], [], []
    for found, a, b, truth, c, d in columns:
        size = np.sum(truth**2, dtype=float)
        squares = (
            np.array([np.sum(part**2, dtype=float) for part in (found - truth, 0.5 * (a - b), 0.5 * (c - d))]) / size
        )
        errors.append(np.sqrt(squares[0]))
        noises.append(np.sqrt(squares[2]))
        biases.append(np.sqrt(max(squares[0] - squares[1] - squares[2], 0.0)))
    print(f"against {count} texels traced alone, {CHECKED_RAYS} rays each, whose noise is {describe(noises)}:")
    print(f"error   {describe(errors)}; goal {GOAL:.0%}")
    print(f"bias    {describe(biases)}; goal {GOAL:.0%}")


def traced_alone(baked: Baked, chosen: np.ndarray, folder: Path) -> Transport:
    """The same transport with a few receivers, each traced with many rays of its own."""
    settings, transport, scene = baked.settings, baked.transport, baked.transport.scene
    tracer, points = Tracer(scene), transport.receivers[chosen]
    gather_map = unwrap(scene, settings.gather_texels, folder)
    samples = lightmap_points(scene, gather_map)
    resolver = HitResolver.create(scene.mesh, gather_map, samples, buried(tracer, samples, 0))
    sampler = HemisphereSampler.create(CHECKED_RAYS, 1)
    hits = trace_hits(tracer, resolver, sampler, points, 0)
    itself = np.repeat(np.arange(len(points))[:, None], 4, axis=1), np.tile(np.float32([1, 0, 0, 0]), (len(points), 1))
    hidden, nodes = transport.buried[chosen], Nodes(points, sampler, *itself)
    return replace(transport, receivers=points, buried=hidden, receiver_hits=hits, nodes=nodes)


def describe(shares: tuple[float, ...] | list[float]) -> str:
    """Percentages by name."""
    return ", ".join(f"{name} {value:.2%}" for name, value in zip(("direct", "indirect", "sum"), shares, strict=True))


if __name__ == "__main__":
    main()
