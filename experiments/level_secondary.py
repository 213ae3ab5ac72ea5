"""Levels with normal maps, and bodies in their air: what vector irradiance and irradiance volumes are worth, and cost.

Walls of a maze get a normal image of bumps. Indirect light on them, from the irradiance of their faces alone and with vectors,
is compared with the traced operator of the same mesh, which follows the image, and the volume of the level with traced probes
at the same places. Prints bytes, errors over lamps anywhere in the maze, and milliseconds of both passes in OpenGL.

    python experiments/level_secondary.py [--blocks 2 11] [--depth 0.25] [--rays 256] [--data FOLDER]

Draws a room of the maze: indirect light of faces, with vectors, path traced; with a body in it, lit by no volume and by that of
the level (Figures 4 and 5 of Loos et al. 2011 in kind).
"""

import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import trimesh
from _frames import arguments, table
from PIL import Image

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.reference_image import reference_image
from data_gen.scenes.maze import ALBEDO
from data_gen.tracer import Tracer
from prt_bench.images import exposure_for, tone_map
from prt_bench.lights import emitters
from prt_bench.metrics import relative_rmse
from prt_bench.modular.atlas import LevelAtlas
from prt_bench.modular.dictionary import Dictionary, standard
from prt_bench.modular.level import Level, LevelTransfer, maze, transfer
from prt_bench.modular.level_secondary import probe_volume, slope, volume
from prt_bench.modular.secondary import PLACES
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera, Mesh, Scene
from prt_bench.store import data_folder
from prt_bench.timing import interleaved

LIT, BOUNCES = 8, 12
SIZE, TIMED = (320, 240), (640, 480)
FINER = 3  # samples along a side of a pixel
PATHS = 128
FACINGS = np.concatenate([np.eye(3), -np.eye(3)])


def bumps(depth: float, side: int = 256, across: int = 6) -> np.ndarray:
    """A normal image [side, side, 3]: round bumps of equal distance, `depth` times as high as they are wide."""
    place = np.mod((np.arange(side) + 0.5) / side * across, 1.0) - 0.5
    x, y = np.meshgrid(place, -place)  # rows from the top
    fall = np.exp(-12.0 * (x**2 + y**2)) * 24.0 * depth
    return np.stack([fall * x, fall * y, np.ones_like(x)], axis=2)


def main() -> None:
    settings = arguments(__doc__, "level_secondary.webp", blocks=[2, 11], depth=0.25, texels=128, rays=256).parse_args()
    folder = settings.data or data_folder()
    dictionary, plain = standard(secondary=True), standard()
    image = bumps(settings.depth)
    tilt = np.degrees(np.arccos(1.0 / np.linalg.norm(image, axis=2)))
    print(
        f"dictionary {plain.bytes / 1e6:.1f} MB, with vectors and volumes of {PLACES}³ places {dictionary.bytes / 1e6:.1f} MB;"
        f" normals are tilted by {np.sqrt(np.mean(tilt**2)):.0f}° (root mean square), {tilt.max():.0f}° at most\n"
    )
    rows = [study(maze(count, seed=0), dictionary, image, settings, folder) for count in settings.blocks]
    table(("blocks", "of faces", "with vectors", "noise", "energy", "volume", "mean of it", "traced probes' s"), rows)
    level = maze(settings.blocks[-1], seed=0)
    opengl(level, transfer(level, dictionary), image)
    draw(level, dictionary, plain, image, settings.out)


def study(level: Level, dictionary: Dictionary, image: np.ndarray, settings, folder) -> tuple:
    """Errors in one maze: of light on surfaces without and with vectors, and of irradiance in the air."""
    scene, count = scene_of(level, ALBEDO, image), len(level.cells)
    ds = prt.bake(scene, "point", 16, settings.texels, settings.rays, 16 * count, out=folder, supersampling=1)
    lightings = lamps(level)
    lit = prt.light(ds, lightings)
    model = transfer(level, dictionary)
    direct = direct_irradiance(Tracer(scene), block_samples(level, dictionary.side), emitters(lightings))
    direct = np.moveaxis(direct.reshape(LIT, count, -1, 3), 0, 2).reshape(count, -1, 3 * LIT)
    albedo = np.repeat(np.array(ALBEDO), dictionary.side**2, axis=0)[None] * np.asarray(model.solid)[:, :, None]
    b, r = model.bounced(jnp.asarray(direct), jnp.tile(jnp.asarray(albedo), LIT), ds.transport.bounces)

    face = scene.mesh.normals[ds.points.face]
    spread = level.interpolation(ds.points.position / EDGE, face, dictionary.side)
    flat = spread @ np.asarray(model.indirect(b, r)).reshape(-1, 3 * LIT)
    vectors = np.asarray(slope(model, b, r))
    change = sum(
        (ds.points.normal - face)[:, axis, None] * (spread @ vectors[:, :, axis].reshape(-1, 3 * LIT))
        for axis in range(3)
    )
    tilted = np.maximum(flat + change, 0.0)
    flat, tilted = (np.moveaxis(each.reshape(-1, LIT, 3), 1, 0) for each in (flat, tilted))

    started = time.perf_counter()
    shape = tuple((PLACES * (np.ptp(np.array(level.cells), axis=0) + 1)).tolist())
    traced = prt.probes(ds, shape, rays=64).light(lightings)
    seconds = time.perf_counter() - started
    air = probe_volume(level, volume(model, b, r), EDGE)
    within = np.random.default_rng(2).uniform(-0.3, 0.3, (8, 3))
    at = (EDGE * (np.array(level.cells)[:, None] + within)).reshape(-1, 3)
    at, facing = np.repeat(at, len(FACINGS), axis=0), np.tile(FACINGS, (len(at), 1))
    wanted = np.asarray(traced.irradiance(jnp.asarray(at), jnp.asarray(facing)))
    found = np.asarray(air.irradiance(jnp.asarray(at), jnp.asarray(facing)))[0]
    found = np.moveaxis(found.reshape(-1, LIT, 3), 1, 0)
    mean = np.broadcast_to(wanted.mean(axis=1, keepdims=True), wanted.shape)
    return (
        count, relative_rmse(flat, lit.indirect), relative_rmse(tilted, lit.indirect), float(np.median(lit.noise)),
        float(tilted.mean() / lit.indirect.mean()), relative_rmse(found, wanted), relative_rmse(mean, wanted), f"{seconds:.0f}",
    )  # fmt: skip


def lamps(level: Level) -> list[prt.Lighting]:
    """A point light in each of some blocks."""
    random = np.random.default_rng(1)
    cells = np.array(level.cells)[random.integers(0, len(level.cells), LIT)]
    places = EDGE * (cells + random.uniform(-0.35, 0.35, (LIT, 3)))
    return [prt.Lighting([prt.PointLight(place, (20.0, 19.0, 17.0))]) for place in places]


def loaded(level: Level, model: LevelTransfer, scene: Scene, size: tuple[int, int]) -> LevelRuntime:
    """A level in OpenGL."""
    side = model.dictionary.side
    return LevelRuntime(LevelAtlas(level, side), model, scene, block_samples(level, side, ALBEDO), EDGE, size)


def opengl(level: Level, model: LevelTransfer, image: np.ndarray) -> None:
    """Milliseconds of what vectors and volumes add to a frame."""
    runtime = loaded(level, model, scene_of(level, ALBEDO, image), TIMED)
    probes, lights = runtime.probes(), runtime.light(lamps(level)[0])
    runtime.draw(lights)
    works = {
        "b, r and light": lambda: (runtime.read(), runtime.arrive(), runtime.respond()),
        "vectors": runtime.tilt, "image": runtime.pad, "volume": lambda: probes.prepare(lights),
        "draw": lambda: runtime.shade(lights),
    }  # fmt: skip

    def clock(work) -> float:
        started = time.perf_counter()
        work()
        runtime.context.finish()
        return (time.perf_counter() - started) * 1e3

    found = interleaved(works, clock, 15, 2)
    told = ", ".join(f"{name} {stage.median:.1f}" for name, stage in found.items())
    print(
        f"\nOpenGL, {len(level.cells)} blocks, {TIMED[0]} × {TIMED[1]}, ms: {told}; volume {probes.bytes / 1e6:.1f} MB"
    )


def draw(level: Level, dictionary: Dictionary, plain: Dictionary, image: np.ndarray, path: Path) -> None:
    """One room: light of faces, of vectors, path traced; then all light without and with a body's own from the volume."""
    scene = scene_of(level, ALBEDO, image)
    other = EDGE * (np.array(level.cells[1], float) - level.cells[0])
    eye, lamp = -0.30 * other + [0.1, 0.35, 0.1], np.array([0.5, 0.9, -0.6])
    camera = Camera(tuple(eye), tuple(0.3 * other - [0.0, 0.6, 0.0]), fov_y=70.0)
    lighting = prt.Lighting([prt.PointLight(tuple(lamp), (9.0, 8.5, 7.5))])
    size = (SIZE[0] * FINER, SIZE[1] * FINER)
    bumpy, faces = (loaded(level, transfer(level, each), scene, size) for each in (dictionary, plain))
    suzanne = prt.load_scene("suzanne")
    body = bumpy.body(figure(suzanne.mesh), (0.7, 0.65, 0.6), bumpy.probes())
    pose = np.eye(4)
    pose[:3, :3] = turned_to(eye)
    pose[:3, 3] = 0.25 * other + [0.0, -0.8, 0.0]
    body.move(pose)
    for runtime in (bumpy, faces):
        runtime.look_from(camera)
    indirect = {"direct": False}
    frames = [
        faces.frame(lighting, BOUNCES, **indirect), bumpy.frame(lighting, BOUNCES, **indirect),
        bumpy.frame(lighting, BOUNCES, indirect=False, bodies=[body]), bumpy.frame(lighting, BOUNCES, bodies=[body]),
    ]  # fmt: skip
    traced = reference_image(scene, lighting, SIZE[1], SIZE[0], PATHS, camera=camera).mean
    traced -= smaller(bumpy.frame(lighting, BOUNCES, indirect=False))
    shown = [*map(smaller, frames[:2]), np.maximum(traced, 0.0), *map(smaller, frames[2:])]
    gap = np.full((SIZE[1], 6, 3), 255, np.uint8)
    panels = [tone_map(frame, exposure_for(shown[1 if at < 3 else 4])) for at, frame in enumerate(shown)]
    joined = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    Image.fromarray(joined).save(path, quality=88)
    away = [np.linalg.norm(frame - shown[2]) / np.linalg.norm(shown[2]) for frame in shown[:2]]
    print(f"frames of indirect light against path tracing with its noise: faces {away[0]:.3f}, vectors {away[1]:.3f}")
    print(f"picture: {path}")


def smaller(frame: np.ndarray) -> np.ndarray:
    """Means of `FINER`² pixels."""
    height, width = frame.shape[0] // FINER, frame.shape[1] // FINER
    return frame.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3))


def figure(mesh: Mesh) -> Mesh:
    """The head of suzanne about its own middle, 0.9 m across: the largest connected part of the scene."""
    parts = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True).split(only_watertight=False)
    head = max(parts, key=lambda part: len(part.faces))
    vertices = np.asarray(head.vertices) - head.bounds.mean(axis=0)
    return Mesh(0.9 * vertices / np.ptp(vertices, axis=0).max(), np.asarray(head.faces), np.zeros(len(head.faces), int))


def turned_to(eye: np.ndarray) -> np.ndarray:
    """About +y, so that +z looks towards the eye."""
    angle = np.arctan2(eye[0], eye[2])
    return np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])


if __name__ == "__main__":
    main()
