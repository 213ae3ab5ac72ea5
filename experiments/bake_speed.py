"""Seconds and memory of a bake, and how long mitsuba's path tracer would take for lightmaps with the same error.

The bake is a user's call of `prt.bake`: compilation, writing, and the held-out lightings on top of the training ones
are all counted. Goals for a Cornell box of 1024² texels, 128 lightings, 256 rays, all bounces, RGB on 2 cores: 180 s
and 8 GB (the source paper reports 6.5 minutes for its bake).

mitsuba (path integrator, `llvm_ad_rgb`, all cores) estimates the same texels under the same lightings, for a random few
of both. Its mean squared error at n paths per texel is half the mean squared difference of two runs, and falls as 1/n;
the bake's is measured against the same two runs, free of their noise, and printed beside the noise the dataset claims
for itself: lights within centimetres of a wall are the noisy ones. Each lighting gets the paths that reach the bake's
error on it; from mitsuba's measured rate follows the time for all texels and lightings. This extrapolation is printed
with its parts. Goal: 100 times the bake's.

    python experiments/bake_speed.py [--texels 1024] [--lightings 128] [--rays 256] [--sample-lightings 6]
"""

import argparse
import os
import resource
import tempfile
import time

import numpy as np

import prt_bench as prt
from tests.oracles.mitsuba_oracle import MitsubaOracle, unavailable
from tests.oracles.operator_light import squared_error


def clocks() -> np.ndarray:
    """Wall and CPU seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--texels", type=int, default=1024)
    parser.add_argument("--lightings", type=int, default=128)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--sample-lightings", type=int, default=6, help="lightings that mitsuba evaluates")
    parser.add_argument("--sample-texels", type=int, default=2000, help="texels that mitsuba evaluates")
    parser.add_argument("--paths", type=int, default=512, help="of mitsuba, per texel and run")
    settings = parser.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        scene = prt.load_scene("cornell")
        started = clocks()
        ds = prt.bake(
            scene, "point", settings.lightings, settings.texels, settings.rays, measurements=256, seed=0, out=folder
        )
        bake = clocks() - started
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        print(f"{len(ds.points)} of {settings.texels}² texels, {settings.lightings} lightings (and")
        print(f"{len(ds) - settings.lightings} held out), {settings.rays} rays, {ds.transport.bounces} bounces, RGB;")
        print(f"gather samples: {len(ds.transport.samples)}")
        stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in ds.metadata["seconds"].items())
        print(f"bake    {bake[0]:8.1f} s wall ({stages}), {bake[1]:.1f} s CPU; goal 180")
        print(f"memory  {memory / 1e9:8.2f} GB peak; goal 8")
        print(f"load    {os.getloadavg()[0]:8.1f} (on {os.cpu_count()} cores)")
        if reason := unavailable():
            print(reason)
            return
        compare(ds, bake, settings)


def compare(ds: prt.LightingDataset, bake: np.ndarray, settings: argparse.Namespace) -> None:
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(settings.lightings, settings.sample_lightings, replace=False))
    texels = np.sort(rng.choice(len(ds.points), min(settings.sample_texels, len(ds.points)), replace=False))
    oracle = MitsubaOracle(ds.scene)
    points = ds.points[texels]

    def run(row: int, seed: int) -> np.ndarray:
        # The bake's point lights have a radius of 1 cm, mitsuba's none: less than 0.2 % at 0.25 m.
        lights = [prt.PointLight(light.position, light.intensity, 0.0) for light in ds.lightings[row].lights]
        return oracle.indirect_irradiance(
            points.position, points.normal, prt.Lighting(lights), settings.paths, seed=seed
        )

    run(rows[0], 0)  # compiles
    started = clocks()
    runs = [(run(row, 1), run(row, 2)) for row in rows]
    spent = clocks() - started
    per_path = spent / (2 * len(rows) * len(texels) * settings.paths)

    baked = ds.arrays["indirect"].oindex[rows, texels]
    ours = np.array([squared_error(estimate, *pair) for estimate, pair in zip(baked, runs, strict=True)])
    theirs = np.array([np.mean((first - second) ** 2) / 2.0 / np.mean(first * second) for first, second in runs])
    # At least two standard errors: an error lost in mitsuba's noise must not count as perfect.
    bound = np.maximum(ours[:, 0], 2.0 * ours[:, 1])
    paths = settings.paths * theirs / bound
    total = per_path * paths.mean() * len(ds.points) * settings.lightings
    print(f"relative RMSE %, by lighting: the bake's, what it claims, mitsuba's at {settings.paths} paths a texel,")
    print("and mitsuba's paths for the bake's error")
    for row, square, claimed, theirs_squared, needed in zip(rows, bound, ds.noise[rows], theirs, paths, strict=True):
        print(
            f"  {row:4d} {100 * square**0.5:7.2f} {100 * claimed:7.2f} {100 * theirs_squared**0.5:7.2f} {needed:9.0f}"
        )
    print(f"   all {100 * bound.mean() ** 0.5:7.2f} (root mean square)")
    print(f"mitsuba {1e-6 / per_path[0]:.2f} M paths/s, so for {len(ds.points)} texels and {settings.lightings}")
    print(f"        lightings {total[0] / 3600:.1f} h wall")
    print(f"ratio   {total[0] / bake[0]:8.0f} of wall time, {total[1] / bake[1]:.0f} of CPU time; goal 100")


if __name__ == "__main__":
    main()
