"""Frames of meshless samples as splats beside those of a lightmap: cost of each pass, and distance from path tracing."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _frames import table
from jaxtyping import Float

import prt_bench as prt
from data_gen.reference_image import reference_image
from prt_bench.assets import RuntimeAsset
from prt_bench.images import exposure_for, tone_map
from prt_bench.runtime import Indirect, LoadedAsset
from prt_bench.runtime.runtime import Runtime
from prt_bench.runtime.splats import SplattedLight
from prt_bench.sampled import SampledLight
from prt_bench.timing import interleaved

TIMED = (1024, 768)
SHOWN = (240, 180)
PATHS, FEWEST = 64, 8  # of each pixel: every vertex of a path is lit by all points, so many points have fewer
ATLAS = 4096  # texels a side, for all faces of all points
ROUNDS = 5


def compare(
    ds: prt.LightingDataset,
    model: SampledLight,
    asset: RuntimeAsset,
    lamp: prt.Lighting,
    grid: Float[np.ndarray, "n 3"],
    path: Path,
) -> None:
    """Tables of milliseconds and of errors under `lamp`, and under its light spread over the points of `grid`; a picture."""
    (source,) = lamp.lights
    shares = np.asarray(source.emitters().intensity)[0] / len(grid)
    lights = {"1 point": lamp, f"{len(grid)} points": prt.Lighting(tuple(prt.PointLight(at, shares) for at in grid))}
    timed(ds, model, asset, lights)
    errors(ds, model, asset, lights, path)


def routes(runtime: Runtime, model: SampledLight, asset: RuntimeAsset) -> dict[str, SplattedLight | LoadedAsset]:
    """Indirect light by splats or by the lightmap, and direct light by compressed shadows or by shadow maps."""
    return {
        "splats": runtime.splats(model),
        "splats, shadow maps": runtime.splats(model, shadow_maps=True),
        "lightmap, shadow maps": runtime.load(asset),
    }


def timed(ds: prt.LightingDataset, model: SampledLight, asset: RuntimeAsset, lights: dict[str, prt.Lighting]) -> None:
    """Milliseconds of passes and frames: those that a route has."""
    runtime = Runtime(ds, size=TIMED, shadow_resolution=ATLAS)
    found = routes(runtime, model, asset)
    splats = found["splats"]
    if not isinstance(splats, SplattedLight):
        raise TypeError("splats come first")
    works: dict[tuple[str, ...], Callable[[], None]] = {}
    for name, lighting in lights.items():
        uploaded = runtime.light(lighting)
        works[name, "samples, direct"] = partial(splats.samples.direct, uploaded)
        works[name, "samples, indirect"] = splats.samples.indirect
        works[name, "splatting"] = splats.splat
        works[name, "shadow maps"] = partial(runtime.shadows.run, uploaded)
        for route, light in found.items():
            works[name, route] = partial(runtime.draw, uploaded, light)

    def clock(work: Callable[[], None]) -> float:
        runtime.context.finish()
        started = time.perf_counter()
        work()
        runtime.context.finish()
        return (time.perf_counter() - started) * 1e3

    stages = interleaved(works, clock, ROUNDS, 1)
    print(f"\nmilliseconds at {TIMED[0]} × {TIMED[1]} on {runtime.device}; passes, then whole frames")
    table(
        ("", *lights),
        [
            (what, *(f"{stages[name, what].median:.0f}" for name in lights))
            for what in dict.fromkeys(key[1] for key in works)
        ],
    )
    print("GPU memory: " + ", ".join(f"{name} {light.bytes / 1e6:.1f} MB" for name, light in found.items()))


def errors(
    ds: prt.LightingDataset, model: SampledLight, asset: RuntimeAsset, lights: dict[str, prt.Lighting], path: Path
) -> None:
    """Relative error of frames against path tracing, without its noise, and all frames in a picture.

    The halves of a picture err independently, so the product of a frame's differences from both is the square of its error,
    on average; where it comes out negative the error is smaller than the picture can tell.
    """
    width, height = SHOWN
    runtime = Runtime(ds, size=SHOWN, shadow_resolution=ATLAS)
    found: dict[str, Indirect] = dict(routes(runtime, model, asset))
    figure, grid = plt.subplots(len(lights), 1 + len(found), figsize=(15, 6.2), layout="constrained")
    rows = []
    for line, (name, lighting) in zip(grid, lights.items(), strict=True):
        reference = reference_image(ds.scene, lighting, height, width, max(PATHS // len(lighting.lights), FEWEST))
        exposure = exposure_for(reference.mean, 0.97)
        truth = tone_map(reference.mean, exposure)
        frames = {route: runtime.frame(lighting, light) for route, light in found.items()}
        for route, frame in frames.items():
            first, second = reference.halves
            error = np.sum((frame - first) * (frame - second)) / np.sum(first * second)
            rows.append((name, route, np.sqrt(error) if error > 0 else "less than the noise shows"))
        pictures = {
            f"path traced, {name}": truth,
            **{each: tone_map(frame, exposure) for each, frame in frames.items()},
        }
        for axes, (title, picture) in zip(line, pictures.items(), strict=True):
            axes.imshow(picture)
            axes.set_title(title)
            axes.set_axis_off()
        print(f"path traced under {name}: noise {reference.noise:.3f}")
    print(f"\nframes of {width} × {height} against path tracing")
    table(("light", "frame", "error"), rows)
    figure.savefig(path, dpi=80)
    plt.close(figure)
