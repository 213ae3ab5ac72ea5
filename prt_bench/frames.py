"""What the runtime adds to a row: frames and their errors, parity with JAX, and timings.

Sits above the runtime and the records; `run.py` calls it for every held-out split.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from data_gen.draw import draw_measurement_points
from data_gen.reference_image import reference_image
from prt_bench.assets import RuntimeAsset
from prt_bench.dataset import LightingDataset
from prt_bench.images import exposure_for, tone_map, write_png
from prt_bench.lights import Lighting
from prt_bench.metrics import flip, ssim
from prt_bench.models import Model
from prt_bench.progress import say
from prt_bench.records import Record, Timing
from prt_bench.report.pictures import write_picture
from prt_bench.runtime.indirect import Indirect, LoadedAsset
from prt_bench.runtime.runtime import Runtime
from prt_bench.runtime.timing import time_assets as time_in_runtime
from prt_bench.spec import TimeSpec
from prt_bench.timing import time_stages

PATHS = 128
"""Paths per pixel of path-traced lobes."""
PARITY = 8
"""Held-out lightings per split on which the runtime is compared with JAX and with ray-traced direct light."""


@dataclass(frozen=True)
class _Reference:
    """One split's frame, tone-mapped at an exposure that suits it: lit by the reference lightmap, with path-traced lobes
    where the scene has any, which no lightmap holds."""

    lighting: Lighting
    exposure: float
    display: Float[np.ndarray, "H W 3"]


class FrameComparison:
    """Renders rows of one dataset under the first lighting of each split and compares them with the reference's frame.

    Raises `RuntimeUnavailable` where there is no OpenGL. `folder` receives the pictures of the test split.
    """

    def __init__(self, ds: LightingDataset, spec: TimeSpec, folder: Path) -> None:
        self.runtime = Runtime(ds, spec.size, spec.shadow_resolution)
        self._name = f"{ds.scene.name}-{ds.metadata['scenario']}"
        self._folder = folder
        self.measurement_picture = f"pictures/{self._name}/measurement-points.png"
        self._references: dict[tuple[int, int], _Reference] = {}
        self._measured: dict[tuple[tuple[int, int], str], float] = {}

    def complete(self, record: Record, model: Model, loaded: LoadedAsset | None, held_out: LightingDataset) -> Record:
        """The record with runtime, measurement, FLIP and SSIM errors, runtime bytes and pictures."""
        reference = self._reference(held_out)
        indirect: Indirect = loaded or self.runtime.lightmap(np.asarray(model.predict(_first(held_out, 1)))[0])
        frame = self.runtime.frame(reference.lighting, indirect)
        display = tone_map(frame, reference.exposure) / 255.0
        pictures = {}
        if record.split == "test":
            alone = self.runtime.frame(reference.lighting, indirect, direct=False)
            pictures = self._write(record.label, {"prediction": frame, "indirect": alone})
            pictures |= {name: f"pictures/{self._name}/{name}.exr" for name in ("reference", "indirect_reference")}
            pictures["measurement_points"] = self.measurement_picture
        scores = {"flip": flip(display, reference.display), "ssim": ssim(display, reference.display)}
        sizes = record.bytes
        if loaded:
            scores |= {"runtime": _parity(loaded, held_out), "measurement": self._measurement_error(loaded, held_out)}
            sizes = {**sizes, "runtime": loaded.bytes}
        return replace(record, errors=replace(record.errors, **scores), bytes=sizes, pictures=pictures)

    def _reference(self, held_out: LightingDataset) -> _Reference:
        if held_out.rows not in self._references:
            lighting, light = held_out.lightings[0], self.runtime.lightmap(held_out.indirect[0])
            final = self.runtime.frame(lighting, light)
            if self.runtime.scene.glossy:
                final += self._lobes(lighting)
            exposure = exposure_for(final)
            display = tone_map(final, exposure) / 255.0
            self._references[held_out.rows] = _Reference(lighting, exposure, display)
            if held_out.rows == held_out.splits["test"]:
                alone = self.runtime.frame(lighting, light, direct=False)
                self._write("", {"reference": final, "indirect_reference": alone})
                draw_measurement_points(held_out, self._folder / self.measurement_picture)
        return self._references[held_out.rows]

    def _lobes(self, lighting: Lighting) -> Float[np.ndarray, "H W 3"]:
        """What lobes reflect in this view, of light and of surfaces, by the independent path tracer.

        Environment lights are themselves there, not the directions that stand for them in a bake.
        """
        width, height = self.runtime.size
        traced = reference_image(self.runtime.scene, lighting, height, width, PATHS, lobes_alone=True)
        say(f"path traced the lobes of {self._name} at {width} × {height} pixels: noise {traced.noise:.1%} of theirs")
        return traced.mean

    def _measurement_error(self, loaded: LoadedAsset, held_out: LightingDataset) -> float:
        """Root mean square over some lightings of the relative error of what the runtime measures; once for all assets
        that measure direct light."""
        ds, direct = _first(held_out, PARITY), loaded.asset.kernels["measure"] == "direct"
        key = held_out.rows, "direct" if direct else loaded.asset.sha256
        if key not in self._measured:
            errors = []
            for lighting, x in zip(ds.lightings, np.asarray(loaded.asset.model().measure(ds)), strict=True):
                lights = self.runtime.light(lighting)
                if direct:
                    self.runtime.shadows.run(lights)
                loaded.measure(lights)
                errors.append(_relative(loaded.measured(), _rgb(x)))
            self._measured[key] = float(np.sqrt(np.mean(np.square(errors))))
        return self._measured[key]

    def _write(self, label: str, images: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Write pictures and return their paths relative to the run's folder."""
        paths = {}
        for name, image in images.items():
            place = Path("pictures") / self._name / label.replace(" ", "-") / f"{name}.exr"
            write_picture(self._folder / place, image)
            paths[name] = place.as_posix()
            if name in ("prediction", "reference"):
                write_png((self._folder / place).with_suffix(".png"), tone_map(image, exposure_for(image)))
        return paths


def time_assets(
    ds: LightingDataset, assets: Mapping[str, RuntimeAsset], loaded: Mapping[str, LoadedAsset], spec: TimeSpec
) -> dict[str, tuple[Timing, ...]]:
    """Timings of assets by label under the first test lighting: in the runtime those that it `loaded`, and all in JAX."""
    test = ds.split("test")
    in_runtime = time_in_runtime(loaded, test.lightings[0], spec.rounds, spec.warmup) if loaded else {}
    in_jax = time_stages(assets, test, spec.rounds, spec.warmup)
    return {label: (*in_runtime.get(label, ()), in_jax[label]) for label in assets}


def _parity(loaded: LoadedAsset, held_out: LightingDataset) -> float:
    """Largest relative difference between the runtime and JAX from the same measured vectors, at receivers that light reaches
    (the runtime fills the buried ones from their neighbours)."""
    model = loaded.asset.model()
    exposed = ~held_out.transport.buried
    worst = 0.0
    for x in np.asarray(model.measure(_first(held_out, PARITY))):
        observed = jnp.asarray(_rgb(x)[None], jnp.float32)
        expected = np.asarray(model.reconstruct(model.transfer(observed)))[0]
        worst = max(worst, _relative(loaded.predict(np.asarray(observed[0]))[exposed], expected[exposed]))
    return worst


def _first(ds: LightingDataset, count: int) -> LightingDataset:
    first, last = ds.rows
    return replace(ds, rows=(first, min(first + count, last)))


def _rgb(values: Float[np.ndarray, "P C"]) -> Float[np.ndarray, "P 3"]:
    """RGB from one or three channels."""
    return np.broadcast_to(values, (len(values), 3))


def _relative(found: np.ndarray, expected: np.ndarray) -> float:
    size = float(np.linalg.norm(expected))
    return float(np.linalg.norm(found - expected)) / size if size > 0 else 0.0
