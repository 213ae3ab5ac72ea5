"""What the hit table costs beyond intersections: our rays per second over bare embreex's on the same rays and cores.

Ours draws directions, traces, and resolves every hit to a gather sample, as a bake does. Bare embreex gets the finished
rays and returns its hits, called by as many threads, with the number of rays per call that suits it best. Rounds
alternate and the ratio is the median over rounds, so a busy machine disturbs both sides alike; the ratio of CPU seconds
shows that neither uses more cores than it should. Goal: 0.85.

    python experiments/trace_rate.py [--scene cornell] [--texels 256] [--rays 256] [--workers 2] [--rounds 9]
"""

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from data_gen.atlas import lightmap_points, unwrap
from data_gen.gather import buried, trace_hits
from data_gen.resolve import HitResolver
from data_gen.scenes import load_scene
from data_gen.tracer import Tracer
from prt_bench.hemisphere import HemisphereSampler
from prt_bench.scene import Scene

CALL_SIZES = (1 << 12, 1 << 14, 1 << 16, 1 << 18)
MOST_RAYS = 1 << 23


def bare_embreex(scene: Scene, origins: np.ndarray, directions: np.ndarray, workers: int) -> Callable[[int], None]:
    """A function that traces all rays, the given number per call."""
    embree = EmbreeScene()
    mesh = TriangleMesh(embree, np.ascontiguousarray(scene.mesh.triangles, np.float32))

    def trace(size: int) -> None:
        parts = [slice(at, at + size) for at in range(0, len(origins), size)]
        with ThreadPoolExecutor(workers) as executor:
            for _ in executor.map(
                lambda part: embree.run(origins[part], directions[part], output=True) and mesh, parts
            ):
                pass

    return trace


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and CPU seconds."""
    started, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - started, time.process_time() - used


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="cornell")
    parser.add_argument("--texels", type=int, default=256)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--rounds", type=int, default=9)
    settings = parser.parse_args()

    scene = load_scene(settings.scene)
    lightmap = unwrap(scene, settings.texels)
    tracer = Tracer(scene, settings.workers)
    everywhere = lightmap_points(scene, lightmap)
    resolver = HitResolver.create(scene.mesh, lightmap, everywhere, buried(tracer, everywhere, 0))
    sampler = HemisphereSampler.create(settings.rays, 0)
    # Texels in the order of the lightmap, as a bake traces them, spread over all of it.
    step = max(len(everywhere) * settings.rays // MOST_RAYS, 1)
    points = everywhere[::step]
    directions = sampler.directions(0, points.normal).reshape(-1, 3)
    origins = np.repeat((points.position + tracer.offset * points.normal).astype(np.float32), settings.rays, axis=0)
    bare = bare_embreex(scene, origins, directions, settings.workers)

    def ours() -> None:
        trace_hits(tracer, resolver, sampler, points, 0)

    ours()  # compiles
    by_size = {size: min(seconds(lambda s=size: bare(s)) for _ in range(3)) for size in CALL_SIZES}
    best = min(by_size, key=by_size.__getitem__)
    rounds = np.array([(seconds(ours), seconds(lambda: bare(best))) for _ in range(settings.rounds)])
    rates = len(directions) / np.median(rounds[:, :, 0], axis=0) / 1e6
    low, wall, high = np.percentile(rounds[:, 1, 0] / rounds[:, 0, 0], [25, 50, 75])
    cpu = np.median(rounds[:, 1, 1] / rounds[:, 0, 1])
    print(f"{scene.name}: {len(scene.mesh.faces)} triangles, {len(points)} points x {settings.rays} rays,")
    print(f"{settings.workers} threads, {settings.rounds} rounds; bare embreex with {best} rays a call")
    print(f"ours  {rates[0]:6.2f} M rays/s   (directions, hits, gather samples)")
    print(f"bare  {rates[1]:6.2f} M rays/s   (hits)")
    print(f"ratio {wall:6.3f} of wall time (quartiles {low:.3f} to {high:.3f}), {cpu:.3f} of CPU time; goal 0.85")


if __name__ == "__main__":
    main()
