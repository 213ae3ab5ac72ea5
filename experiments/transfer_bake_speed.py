"""How long a large bake of classical transfer vectors takes, and how much memory and noise it has.

Traces the scene as `prt.bake` does, then collects the direct transfer vectors from the rays that escape and sends those at
the gather samples through all bounces: what `sh-texture` ships. Goal: an order-5 texture of 1024² texels in 4 minutes on two
cores, with a noise of at most 1 %; the source paper names about 3 hours.

Noise comes from two textures T_a and T_b of half of the rays each, which share nothing but the surface: ‖T_a − T_b‖ / 2‖T‖
over all texels, channels and coefficients. It hardly depends on the number of texels, so without `--rays` the least power of
two that meets the goal is looked for on 128² texels first.

    python experiments/transfer_bake_speed.py [--scene room] [--texels 1024] [--order 5] [--rays N] [--out DIR]
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

import jax.numpy as jnp
import numpy as np

import prt_bench as prt
from data_gen.plan import plan
from data_gen.trace import trace
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.methods.escaping import direct_transfer
from prt_bench.methods.operator import respond

MINUTES, NOISE = 4.0, 0.01
SMALL = 128
RAYS = tuple(1 << power for power in range(5, 14))
Vectors = tuple[np.ndarray, np.ndarray]


Seconds = dict[str, np.ndarray]
"""Wall and CPU seconds by stage."""


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
    parser.add_argument("--rays", type=int, help="per texel; without it the least that meets the noise goal")
    parser.add_argument("--out", type=Path, help="where hit tables are kept; without it they are thrown away")
    settings = parser.parse_args()
    with TemporaryDirectory() as folder:
        where = settings.out or Path(folder)
        rays = settings.rays or least_rays(settings.scene, settings.order, where)
        transport, vectors = report(settings.scene, settings.texels, rays, settings.order, where)
        noise = split_half(transport, vectors, settings.order)
        print(f"noise   {describe(noise)}; goal {NOISE:.0%}")


def least_rays(scene: str, order: int, folder: Path) -> int:
    """The least power of two whose direct and indirect transfer together meet the goal, on a small texture."""
    print(f"noise at {SMALL}² texels, of direct and indirect transfer and their sum:")
    for rays in RAYS:
        transport, vectors = collect(scene, SMALL, rays, order, folder, {})
        noise = split_half(transport, vectors, order)
        print(f"  {rays:5d} rays: {describe(noise)}", flush=True)
        if noise[-1] <= NOISE:
            return rays
    raise SystemExit(f"{RAYS[-1]} rays leave a noise of {noise[-1]:.2%}, more than {NOISE:.0%}")


def collect(
    scene: str, texels: int, rays: int, order: int, folder: Path, seconds: Seconds
) -> tuple[Transport, Vectors]:
    """What a bake of transfer vectors consists of, each step timed."""
    with timed(seconds, "plan"):
        loaded = prt.load_scene(scene)
        tracer, settings = Tracer(loaded), plan(loaded, "environment", texels=texels, rays=rays)
    with timed(seconds, "unwrap, trace, resolve"):
        transport = trace(loaded, settings, 0, folder, tracer)
    with timed(seconds, "direct transfer"):
        direct = direct_transfer(transport, transport.receiver_hits, transport.receivers, order)
    with timed(seconds, "direct transfer at the gather samples"):
        at_samples = direct_transfer(transport, transport.sample_hits, transport.samples, order)
    with timed(seconds, "inter-reflections"):
        indirect = respond(transport, albedo(transport), at_samples)
    return transport, (direct, indirect)


def albedo(transport: Transport) -> jnp.ndarray:
    """Of the gather samples, in as many channels as the scene has."""
    return jnp.asarray(transport.samples.albedo[:, : 1 if transport.scene.achromatic else 3], jnp.float32)


def report(scene: str, texels: int, rays: int, order: int, folder: Path) -> tuple[Transport, Vectors]:
    """One timed bake; its seconds and memory are printed."""
    seconds: Seconds = {}
    load = os.getloadavg()[0]
    transport, vectors = collect(scene, texels, rays, order, folder, seconds)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(
        f"{scene}: {len(transport.receivers)} of {texels}² texels, {rays} rays, order {order}, {transport.bounces} bounces,"
    )
    print(
        f"{vectors[1].shape[1]} channels; {len(transport.samples)} gather samples, {len(transport.scene.mesh.faces)} triangles"
    )
    for name, (wall, cpu) in seconds.items():
        print(f"  {name:38} {wall:8.1f} s wall, {cpu:8.1f} s CPU")
    wall, cpu = np.sum(list(seconds.values()), axis=0)
    print(f"bake    {wall:8.1f} s wall, {cpu:.1f} s CPU; goal {60 * MINUTES:.0f} s")
    print(f"load    {load:8.1f} before, on {os.cpu_count()} cores")
    print(f"memory  {memory / 1e9:8.2f} GB peak", flush=True)
    return transport, vectors


def split_half(transport: Transport, vectors: Vectors, order: int) -> tuple[float, float, float]:
    """Noise of the direct and the indirect transfer and of their sum, from the two halves of the rays."""
    first, second = (halved(transport, order, half) for half in (0, 1))
    total = [direct[:, None] + indirect for direct, indirect in (vectors, first, second)]
    pairs = (*zip(vectors, first, second, strict=True), total)
    direct, indirect, both = (np.linalg.norm(a - b) / (2.0 * np.linalg.norm(whole)) for whole, a, b in pairs)
    return float(direct), float(indirect), float(both)


def halved(transport: Transport, order: int, half: int) -> Vectors:
    """Transfer vectors from one half of the rays alone, in every bounce."""
    rays = transport.receiver_hits.shape[1]
    chosen = slice(half * rays // 2, (half + 1) * rays // 2)
    sampler = transport.sampler
    assert sampler is not None
    part = replace(
        transport,
        receiver_hits=np.asarray(transport.receiver_hits[:, chosen]),
        sample_hits=np.asarray(transport.sample_hits[:, chosen]),
        sampler=HemisphereSampler.stored(
            np.asarray(sampler.local)[:, chosen], np.stack(sampler.jitter)[:, :, chosen], sampler.seed
        ),
    )
    direct = direct_transfer(part, part.receiver_hits, part.receivers, order)
    at_samples = direct_transfer(part, part.sample_hits, part.samples, order)
    return direct, respond(part, albedo(part), at_samples)


def describe(noise: tuple[float, float, float]) -> str:
    """Percentages by name."""
    return ", ".join(f"{name} {value:.2%}" for name, value in zip(("direct", "indirect", "sum"), noise, strict=True))


if __name__ == "__main__":
    main()
