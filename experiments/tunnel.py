"""Tunnels of pipes: their dictionary, and light in the scene `tunnel`, ten pieces, and in a random tunnel of twenty.

Prints seconds and bytes of the dictionary. Twelve lamps, one at a time, light each tunnel; indirect light after one bounce and
after all of them is compared with the traced operator of the tunnel's own mesh, beside `operator-ridge` fitted to that mesh and
an ambient term (the mean direct light times the factor that fits best). Under three of the lamps both the modular light and
that of the traced operator are held against an independent path tracer's at 400 receivers, free of its noise as the mean of
(x − A)(x − B) over its halves A and B. Then milliseconds of b, r and light on one core, in
JAX and prepared in NumPy, and of the passes of a frame in OpenGL.

    python experiments/tunnel.py [--texels 128] [--rays 256] [--paths 128] [--data FOLDER]

Draws the scene from two places under a lamp round a corner: direct light and light after all bounces in OpenGL, and the path
tracer's picture. Keeps the dictionary beside the bakes.
"""

import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from _frames import Row, arguments, draw, table
from level_runtime import CORE_HEADS, SIZE, core_row, single_core, stages
from modular import ambient_error

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.reference import indirect_irradiance
from data_gen.reference_image import reference_image
from data_gen.scenes.tunnel import FLOOR, WALLS
from data_gen.tracer import Tracer
from data_gen.tunnels import EDGE, scene_of, tunnel_samples
from prt_bench.lights import emitters
from prt_bench.metrics import relative_rmse
from prt_bench.modular.pipe_dictionary import PipeDictionary, build
from prt_bench.modular.tunnel import Tunnel, load_tunnel, random_tunnel, transfer
from prt_bench.modular.tunnel_atlas import TunnelAtlas
from prt_bench.points import SurfacePoints
from prt_bench.runtime import headless, renderer
from prt_bench.runtime.level import LevelRuntime
from prt_bench.scene import Camera, Scene
from prt_bench.store import data_folder
from prt_bench.transport import indirect

TUNNEL = Path(__file__).parent / "levels" / "tunnel.toml"
LIT = 12  # lamps that are compared
FOLLOWED, PATHS = 3, 4096  # lamps that a path tracer lights too, and its paths from each receiver
OUTPUT = (20.0, 19.0, 17.0)
DRAWN = (240, 180)
VIEWS = {
    "lamp behind a bend": ((0.0, 0.0), (1.0, -0.3), (1.0, -1.1)),
    "lamp two bends away": ((3.0, -1.0), (4.0, -1.1), (4.4, -2.0)),
}
"""Where the eye is, what it looks at, and where the lamp is: places along x and z, in cells."""


def main() -> None:
    settings = arguments(__doc__, "tunnel.webp", texels=128, rays=256, paths=128).parse_args()
    folder = Path(settings.data or data_folder())
    started, busy = time.perf_counter(), time.process_time()
    dictionary = build()
    seconds, busy = time.perf_counter() - started, time.process_time() - busy
    print(f"dictionary: {seconds:.0f} s, {busy:.0f} s of cores, {dictionary.bytes / 1e6:.1f} MB\n", flush=True)
    dictionary.save(folder / "pipes.safetensors")
    tunnels = load_tunnel(TUNNEL), random_tunnel(20, seed=1)
    found = [study(tunnel, dictionary, settings, folder) for tunnel in tunnels]
    head = ("pieces", "bounces", "modular", "operator-ridge b64", "ambient", "light, modular / traced", "noise")
    table(head, [row for rows, _ in found for row in rows])
    print()
    names = "modular", "traced operator"
    heads = (*(f"{name}, error" for name in names), *(f"{name} / path tracer" for name in names))
    table(("pieces, against a path tracer", *heads), [row for _, row in found])
    print()
    with single_core():
        core = [core_row(transfer(tunnel, dictionary)) for tunnel in tunnels]
    table(("pieces", *CORE_HEADS), core)
    print(f"\nOpenGL, {renderer(headless())}, frames of {SIZE[0]} × {SIZE[1]}, one bounce")
    frames = [stages(loaded(tunnel, dictionary, SIZE), lamp(1.5, 0.0)) for tunnel in tunnels]
    names = tuple(frames[0])
    table(
        ("pieces", *names),
        [
            (len(tunnel.pieces), *(f"{found[name]:.2f}" for name in names))
            for tunnel, found in zip(tunnels, frames, strict=True)
        ],
    )
    show(settings.out, tunnels[0], dictionary, settings.paths)


def lamp(x: float, z: float) -> prt.Lighting:
    """A lamp near the ceiling, places in cells."""
    return prt.Lighting([prt.PointLight((EDGE * x, 0.12 * EDGE, EDGE * z), OUTPUT)])


def study(tunnel: Tunnel, dictionary: PipeDictionary, settings, folder: Path) -> tuple[list[tuple], tuple]:
    """One tunnel: rows of the table for one bounce and for all, and of that against a path tracer."""
    scene, count, lightings = scene_of(tunnel, WALLS, FLOOR), len(tunnel.pieces), lamps(tunnel)
    ds = prt.bake(scene, "point", 128, settings.texels, settings.rays, 16 * count, seed=0, out=folder, supersampling=1)
    lit, transport, rows, followed = prt.light(ds, lightings), ds.transport, [], ()
    spread = tunnel.interpolation(ds.points.position / EDGE, dictionary.side)
    modular = modular_light(tunnel, dictionary, scene, lightings, (1, transport.bounces))
    traced = {
        1: np.asarray(
            indirect(transport.sample_gather(), jnp.asarray(ds.points.albedo, jnp.float32), jnp.asarray(lit.direct), 1)
        ),
        transport.bounces: lit.indirect,
    }
    fitted = prt.method("operator-ridge", basis=64).fit(ds.split("train"))
    for bounces, wanted in traced.items():
        ours = np.moveaxis((spread @ modular[bounces]).reshape(-1, LIT, 3), 1, 0)
        error, ambient = relative_rmse(ours, wanted), ambient_error(lit.direct, wanted)
        ridge, noise = "", ""
        if bounces > 1:
            ridge = f"{relative_rmse(np.asarray(fitted.predict(lit)), wanted):.3f}"
            noise = f"{np.median(lit.noise):.3f}"
            followed = (count, *against_paths(scene, ds.points, lightings, (ours, wanted)))
        told = "1" if bounces == 1 else "all"
        rows.append((count, told, f"{error:.3f}", ridge, f"{ambient:.3f}", f"{ours.mean() / wanted.mean():.3f}", noise))
    return rows, followed


def lamps(tunnel: Tunnel) -> list[prt.Lighting]:
    """One lamp each, anywhere in the tunnel but close to its wall."""
    random, found = np.random.default_rng(1), []
    for piece in random.integers(0, len(tunnel.pieces), LIT):
        wall, normal = tunnel.place(piece, *random.uniform(0, 1, (2, 1)))
        found.append(
            prt.Lighting([prt.PointLight(tuple(EDGE * (wall + random.uniform(0.08, 0.3) * normal)[0]), OUTPUT)])
        )
    return found


def modular_light(
    tunnel: Tunnel, dictionary: PipeDictionary, scene: Scene, lightings: list[prt.Lighting], bounces: tuple[int, ...]
) -> dict[int, np.ndarray]:
    """Indirect light at the samples [N n, lamps and channels] after each number of bounces."""
    points, count = tunnel_samples(tunnel, dictionary.side, WALLS, FLOOR), len(tunnel.pieces)
    direct = direct_irradiance(Tracer(scene), points, emitters(lightings))
    direct = jnp.asarray(np.moveaxis(direct.reshape(LIT, count, -1, 3), 0, 2).reshape(count, -1, 3 * LIT), jnp.float32)
    albedo = jnp.tile(jnp.asarray(points.albedo.reshape(count, -1, 3), jnp.float32), LIT)
    model = transfer(tunnel, dictionary)
    return {each: np.asarray(model(direct, albedo, each)).reshape(-1, 3 * LIT) for each in bounces}


def against_paths(
    scene: Scene, points: SurfacePoints, lightings: list[prt.Lighting], lights: tuple[np.ndarray, ...]
) -> tuple[str, ...]:
    """Errors of indirect light at the points, and its sums over the path tracer's, for each of `lights`."""
    some = np.random.default_rng(2).choice(len(points), 400, replace=False)
    place, normal = points.position[some], points.normal[some]
    halves = np.stack(
        [indirect_irradiance(scene, place, normal, each, PATHS).halves for each in lightings[:FOLLOWED]], axis=1
    )  # [2, lamps, points, 3]
    shown, true = [light[:FOLLOWED][:, some] for light in lights], halves.mean(axis=0)
    errors = (f"{noiseless_error(light, halves):.3f}" for light in shown)
    return *errors, *(f"{light.sum() / true.sum():.3f}" for light in shown)


def noiseless_error(light: np.ndarray, halves: np.ndarray) -> float:
    """Relative RMSE of light [lamps, ·, 3] against a mean of which `halves` [2, lamps, ·, 3] have independent noise."""
    square = np.sum((light - halves[0]) * (light - halves[1]), axis=(1, 2)) / np.sum(halves[0] * halves[1], axis=(1, 2))
    return float(np.sqrt(max(square.mean(), 0.0)))


def loaded(tunnel: Tunnel, dictionary: PipeDictionary, size: tuple[int, int]) -> LevelRuntime:
    """The tunnel's own scene in OpenGL."""
    points, side = tunnel_samples(tunnel, dictionary.side, WALLS, FLOOR), dictionary.side
    operator, scene = transfer(tunnel, dictionary), scene_of(tunnel, WALLS, FLOOR)
    return LevelRuntime(TunnelAtlas(tunnel, side), operator, scene, points, EDGE, size)


def show(path: Path, tunnel: Tunnel, dictionary: PipeDictionary, paths: int) -> None:
    """Frames of the views, and how far those with indirect light are from the path tracer's."""
    runtime, rows = loaded(tunnel, dictionary, DRAWN), []
    for name, (eye, target, light) in VIEWS.items():
        camera = Camera(*((EDGE * x, 0.0, EDGE * z) for x, z in (eye, target)), fov_y=75.0)
        runtime.look_from(camera)
        lighting = lamp(*light)
        traced = reference_image(runtime.scene, lighting, DRAWN[1], DRAWN[0], paths, camera=camera)
        frames = {
            "direct": runtime.frame(lighting, indirect=False),
            "with indirect": runtime.frame(lighting, 24),
            "reference": traced.mean,
        }
        halves = traced.halves.reshape(2, 1, -1, 3)
        errors = {
            title: noiseless_error(frames[title].reshape(1, -1, 3), halves) for title in ("direct", "with indirect")
        }
        captions = {title: f"error {error:.1%}" for title, error in errors.items()}
        captions["reference"] = f"noise {traced.noise:.1%}"
        rows.append(Row(name, frames, captions))
    draw(path, rows)


if __name__ == "__main__":
    main()
