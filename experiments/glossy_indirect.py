"""Lobes that reflect indirect light: nine coefficients a glossy receiver, predicted beside the lightmap and drawn with it.

`svd-ridge` is fitted to the lightmap and to `Directional.dataset`. Prints, for each scene, seconds that the coefficients took
(no ray is traced for them), relative errors of both on held-out lightings, milliseconds and megabytes of a frame with and
without lobes, and, where the path tracer knows all that the scene has, the relative error of indirect light in the pixels of
glossy surfaces: the path tracer's lobes are not cut to three bands. Its noise is taken out of the error, by multiplying errors
against two halves of its paths. Leaves a picture of indirect light: diffuse alone, with lobes, and path traced.

    python experiments/glossy_indirect.py [--scenes objects medley] [--basis 16] [--texels 128] [--rays 128] [--lightings 64]
        [--paths 256] [--rounds 15]
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from _frames import Row, arguments, draw, median_lighting, table

import prt_bench as prt
from data_gen.reference_image import camera_directions, reference_image
from data_gen.tracer import Tracer
from prt_bench.metrics import relative_rmse
from prt_bench.runtime.indirect import Indirect
from prt_bench.runtime.runtime import Runtime
from prt_bench.timing import interleaved

SIZE = (320, 240)
COLUMNS = (
    "scene", "glossy texels", "s", "lightmap error", "coefficients' error", "ms without", "ms with", "MB without", "MB with",
    "glossy pixels' error without", "with",
)  # fmt: skip


def main() -> None:
    parser = arguments(
        __doc__, "glossy_indirect.webp", scenes=["objects", "medley"], scenario="point", basis=16, texels=128, rays=128,
        lightings=64, paths=256, rounds=15,
    )  # fmt: skip
    chosen = parser.parse_args()
    lines, rows, device = [], [], ""
    for name in chosen.scenes:
        ds = prt.bake(
            prt.load_scene(name), chosen.scenario, chosen.lightings, chosen.texels, chosen.rays, out=chosen.data
        )
        started = time.perf_counter()
        found = prt.directional(ds)
        lit = found.dataset()
        seconds = time.perf_counter() - started
        method, runtime = (
            prt.method("svd-ridge", basis=chosen.basis, transfer="per-channel", mean=False),
            Runtime(ds, SIZE),
        )
        device = runtime.device
        with TemporaryDirectory() as folder:
            room, gloss = (
                method.fit(part.split("train")).export(Path(folder) / each)
                for each, part in (("room", ds), ("gloss", lit))
            )
            test, index = ds.split("test"), median_lighting(room, ds.split("test"))
            without = runtime.load(room)
            shown = {"diffuse": without, "with lobes": runtime.glossy(without, gloss, found.rows)}
            errors = (
                relative_rmse(room.predict(test), test.indirect),
                relative_rmse(gloss.predict(lit.split("test")), lit.split("test").indirect),
            )
            lights = runtime.light(test.lightings[index])
            spent = interleaved(shown, lambda light, r=runtime, on=lights: milliseconds(r, on, light), chosen.rounds, 2)
            frames = {each: runtime.frame(lights, light, direct=False) for each, light in shown.items()}
        against: list[float | None] = [None, None]
        if not (ds.scene.translucent or ds.scene.strands):
            traced = indirect_halves(ds.scene, test.lightings[index], chosen.paths)
            glossy = glossy_pixels(ds.scene)
            against = [error(frame[glossy], traced[:, glossy]) for frame in frames.values()]
            frames["path traced"] = np.maximum(traced.mean(axis=0), 0.0)
        rows.append(Row(f"{name}, lighting {index}", frames, {}))
        lines.append((
            name, len(found.rows), f"{seconds:.1f}", *errors, *(f"{spent[each].median:.1f}" for each in shown),
            *(f"{light.bytes / 1e6:.1f}" for light in shown.values()), *against,
        ))  # fmt: skip
    print(f"{SIZE[0]} × {SIZE[1]} pixels on {device}, medians of {chosen.rounds} rounds\n")
    table(COLUMNS, lines)
    draw(chosen.out, rows, lambda title: "diffuse")


def milliseconds(runtime: Runtime, lights: object, light: Indirect) -> float:
    """A frame."""
    started = time.perf_counter()
    runtime.draw(lights, light)  # pyright: ignore[reportArgumentType]
    runtime.context.finish()
    return (time.perf_counter() - started) * 1e3


def indirect_halves(scene: prt.Scene, lighting: prt.Lighting, paths: int) -> np.ndarray:
    """Radiance [2, H, W, 3] of all light less that of direct light, from two halves of the paths."""
    whole, direct = (
        reference_image(scene, lighting, SIZE[1], SIZE[0], paths, bounces, diffuse_between=True)
        for bounces in (None, 0)
    )
    return whole.halves - direct.halves


def glossy_pixels(scene: prt.Scene) -> np.ndarray:
    """Which pixels [H, W] show a surface with a lobe."""
    direction = camera_directions(scene.camera, SIZE[1], SIZE[0]).reshape(-1, 3)
    hits = Tracer(scene).intersect(
        np.broadcast_to(np.asarray(scene.camera.position, float), direction.shape), direction
    )
    lobes = np.array([material.glossy is not None for material in scene.materials])
    return ((hits.face >= 0) & hits.front & lobes[scene.mesh.material[hits.face]]).reshape(SIZE[::-1])


def error(frame: np.ndarray, halves: np.ndarray) -> float:
    """Relative root mean square error, free of the noise of the two halves [2, n, 3]."""
    square = np.mean((frame - halves[0]) * (frame - halves[1]))
    return float(np.sqrt(max(square, 0.0) / np.mean(halves[0] * halves[1])))


if __name__ == "__main__":
    main()
