"""What two ways of laying out a lightmap buy: a square for each object (texture sets), and halved images (mip levels).

The light of the traced scenes under the sun, direct and indirect together, is kept in the lightmap and drawn from it alone, so
that frames differ by the layout and nothing else. Only pixels that show one material throughout are compared, in radiance.

Texture sets: error of each object near the camera, from an atlas that all objects share by area and from a set of squares of
the same size together, against a lightmap of four times as many texels a side. `shared as set` gives the atlas those texels
that the set has, since squares of a set are filled less well.

Mip levels: the scene in a frame of few pixels while the camera moves by a fraction of them, against the mean of 16 × 16 pixels
in each, drawn from the lightmap without mip levels. Error of the frames; temporal error, that of the change from frame to
frame (`temporal_error`); milliseconds of a whole frame of `sh-texture` at 640 × 480 from the lightmaps in interleaved rounds.

    python experiments/texture_sets.py [--sets objects room] [--mips objects plants] [--texels 512] [--rays 64] [--data DIR]
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from _frames import Row, arguments, draw, ship, table
from jaxtyping import Bool, Float, Int

import prt_bench as prt
from data_gen.geometry import rotation_about
from data_gen.reference_image import camera_directions
from data_gen.tracer import Tracer
from prt_bench.metrics import relative_rmse, temporal_error
from prt_bench.runtime.runtime import Runtime
from prt_bench.scene import Camera, Scene
from prt_bench.store import data_folder
from prt_bench.timing import interleaved

SUN = prt.Lighting([prt.DirectionalLight((-0.6, -1.0, -0.25), (3.0, 2.9, 2.7))])
NEAR, FAR, TIMED = (320, 240), (64, 48), (640, 480)
WITHIN = 16
"""Pixels of the reference along a side of a pixel."""
STEPS, DEGREES = 12, 0.15
"""Frames of the moving camera, and by how much it turns about the scene between them."""
LEVELS = range(4)
ORDER, ROUNDS = 5, 15


def main() -> None:
    parser = arguments(
        __doc__, "texture_sets.webp", sets=["objects", "room"], mips=["objects", "plants"], texels=512, rays=64
    )
    settings = parser.parse_args()
    data = settings.data or data_folder()
    rows: list[Row] = []
    lines: list[list] = []
    for name in settings.sets:
        lines += sets(name, settings.texels, settings.rays, data, rows)
    head = ("scene", "object", "its share of the surface", "shared", "set", "shared as set", "shared over set")
    print(f"\nrelative error of an object's pixels; {settings.texels // 4}² texels, {NEAR[0]} × {NEAR[1]} pixels\n")
    table(head, lines)
    lines = [line for name in settings.mips for line in levels(name, settings.texels, settings.rays, data, rows)]
    print(f"\n{settings.texels}² texels, {FAR[0]} × {FAR[1]} pixels, {STEPS} frames\n")
    table(("scene", "mip levels", "texels covered", "MB", "error", "temporal error", "ms of a frame"), lines)
    draw(settings.out, rows)


def sets(name: str, texels: int, rays: int, data: Path, rows: list[Row]) -> list[list]:
    """A line for every object that enough pixels show; a picture is added to `rows`."""
    scene = prt.load_scene(name)
    shown = materials(scene, scene.camera, *NEAR)
    reference = _frame(lit(scene, texels, rays, data), scene)
    small = texels // 4
    layouts = {"shared": lit(scene, small, rays, data), "set": lit(scene, small, rays, data, texture_set=True)}
    fewer = small * np.sqrt(len(layouts["set"].points) / len(layouts["shared"].points))
    layouts["shared as set"] = lit(scene, 2 * round(fewer / 2), rays, data)
    frames = {title: _frame(ds, scene) for title, ds in layouts.items()}
    area = np.bincount(scene.mesh.material, scene.mesh.areas)
    lines, captions = [], {}
    for index, material in enumerate(scene.materials):
        mine = shown == index
        if mine.sum() >= 100:
            errors = {
                title: relative_rmse(frame[mine][None], reference[mine][None]) or 0.0 for title, frame in frames.items()
            }
            share = f"{area[index] / area.sum():.1%}"
            lines.append([name, material.name, share, *errors.values(), errors["shared"] / errors["set"]])
    pure = shown >= 0
    for title, frame in frames.items():
        error = relative_rmse(frame[pure][None], reference[pure][None])
        captions[title] = f"{len(layouts[title].points):,} texels, error {error:.1%}"
    rows.append(Row(f"{name}: sets", {"reference": reference, **frames}, captions))
    return lines


def levels(name: str, texels: int, rays: int, data: Path, rows: list[Row]) -> list[list]:
    """A line for every number of mip levels; a picture is added to `rows`."""
    scene = prt.load_scene(name)
    cameras = [turned(scene.camera, DEGREES * step) for step in range(STEPS)]
    pure = np.all([materials(scene, camera, *FAR) >= 0 for camera in cameras], axis=0)
    layouts = [lit(scene, texels, rays, data, mips=count) for count in LEVELS]
    large = Runtime(layouts[0], (FAR[0] * WITHIN, FAR[1] * WITHIN))
    truth = [shrunk(frame) for frame in moving(large, layouts[0], cameras)]
    with TemporaryDirectory() as folder:
        milliseconds = _times(layouts, folder)
    lines, frames = [], {"reference": truth[0]}
    for ds, spent in zip(layouts, milliseconds, strict=True):
        runtime = Runtime(ds, FAR)
        drawn = moving(runtime, ds, cameras)
        ours, theirs = (np.array([frame[pure] for frame in part]) for part in (drawn, truth))
        count = ds.lightmap.mips
        title = f"{count} mip level{'s' * (count != 1)}"
        frames[title] = drawn[0]
        covered = f"{len(ds.points) / texels**2:.0%}"
        megabytes = f"{runtime.lightmap(ds.direct[0]).bytes / 1e6:.2f}"
        lines.append(
            [name, count, covered, megabytes, relative_rmse(ours, theirs), temporal_error(ours, theirs), f"{spent:.1f}"]
        )
    captions = {title: f"error {line[4]:.1%}" for title, line in zip(list(frames)[1:], lines, strict=True)}
    rows.append(Row(f"{name}: mips", frames, captions))
    return lines


def lit(scene: Scene, texels: int, rays: int, data: Path, **layout: bool | int) -> prt.LightingDataset:
    """The scene under the sun from a lightmap laid out so."""
    baked = prt.bake(scene, "directional", 1, texels, rays, 16, out=data, gather_texels=min(texels, 128), **layout)
    return prt.light(baked, [SUN])


def moving(runtime: Runtime, ds: prt.LightingDataset, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """A frame from each camera, lit from the lightmap alone."""
    light, frames = runtime.lightmap((ds.direct + ds.indirect)[0]), []
    for camera in cameras:
        runtime.look_from(camera)
        frames.append(runtime.frame(SUN, light, direct=False))
    return frames


def materials(scene: Scene, camera: Camera, width: int, height: int, within: int = 4) -> Int[np.ndarray, "H W"]:
    """The material that a pixel shows, −1 where it shows none or several; looked up at `within`² places in each."""
    direction = camera_directions(camera, height * within, width * within).reshape(-1, 3)
    hits = Tracer(scene).intersect(np.broadcast_to(camera.position, direction.shape), direction)
    met = np.where(hits.front & (hits.face >= 0), scene.mesh.material[hits.face], -1)
    parts = met.reshape(height, within, width, within)
    return np.where(_all_alike(parts), parts[:, 0, :, 0], -1)


def _all_alike(parts: Int[np.ndarray, "H k W k"]) -> Bool[np.ndarray, "H W"]:
    return parts.min(axis=(1, 3)) == parts.max(axis=(1, 3))


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera gone round its target."""
    target = np.array(camera.target)
    position = target + rotation_about(1, degrees) @ (np.array(camera.position) - target)
    return replace(camera, position=tuple(position))


def shrunk(frame: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "H W 3"]:
    """Means over `WITHIN`² pixels."""
    height, width, _ = frame.shape
    return frame.reshape(height // WITHIN, WITHIN, width // WITHIN, WITHIN, 3).mean(axis=(1, 3))


def _frame(ds: prt.LightingDataset, scene: Scene) -> np.ndarray:
    return moving(Runtime(ds, NEAR), ds, [scene.camera])[0]


def _times(layouts: Sequence[prt.LightingDataset], folder: str) -> list[float]:
    """Median milliseconds of a whole frame of `sh-texture` from each lightmap."""
    stages = {}
    for ds in layouts:
        runtime = Runtime(ds, TIMED)
        asset = ship({f"mips-{ds.lightmap.mips}": prt.method("sh-texture", order=ORDER)}, ds, folder)
        loaded, lights = runtime.load(*asset.values()), runtime.light(SUN)

        stages[ds.lightmap.mips] = partial(runtime.draw, lights, loaded)
    context = runtime.context

    def clock(work: partial[None]) -> float:
        context.finish()
        started = perf_counter()
        work()
        context.finish()
        return (perf_counter() - started) * 1e3

    return [stage.median for stage in interleaved(stages, clock, ROUNDS, 2).values()]


if __name__ == "__main__":
    main()
