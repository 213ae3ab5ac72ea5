"""Modular radiance transfer: a dictionary of blocks, levels made of it, and what that costs and misses.

Builds the dictionary of flat levels and that of levels with several layers (seconds, bytes; singular values that hold 80, 90
and 95 % of the energy, beside the source paper's). Random mazes, flat ones and ones of three layers, and a hall of 27 blocks
are then lit by a light in each of some blocks; indirect light after one bounce and after all of them is compared with the
traced operator of the level's own mesh, beside `operator-ridge` fitted to that level and an ambient term (the mean direct light
times the factor that fits best). What a frame of such a maze costs is in `level_runtime.py`.

    python experiments/modular.py [--blocks 2 11 41] [--tall 11 41] [--texels 128] [--data FOLDER]

Draws the floor of the second flat maze, and the floors of the last tall one from the lowest up: traced, modular, and their
difference. Keeps the flat dictionary beside the bakes.
"""

import time
from itertools import product
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from _frames import arguments, floors, table
from scipy.spatial import KDTree

import prt_bench as prt
from data_gen.direct import direct_irradiance
from data_gen.levels import EDGE, block_samples, scene_of
from data_gen.scenes.maze import ALBEDO
from data_gen.tracer import Tracer
from prt_bench.lights import emitters
from prt_bench.metrics import relative_rmse
from prt_bench.modular.cube import one_bounce
from prt_bench.modular.dictionary import Dictionary, build
from prt_bench.modular.level import Level, maze, transfer
from prt_bench.modular.modes import direct_light, enriched, needed
from prt_bench.store import data_folder
from prt_bench.transport import indirect

SHARES = (0.8, 0.9, 0.95)
PAPER = {"F": (164, 240, 313), "L": (22, 41, 62), "M": (1, 5, 8)}
LAYERS = 3  # of a tall maze
HALL = Level(tuple(product(range(LAYERS), repeat=3)))  # no walls within: six blocks have one face, and one has none
LIT = 12  # lightings that are compared
PIXELS = 40  # of a picture along a block


def main() -> None:
    parser = arguments(__doc__, "modular.webp", blocks=[2, 11, 41], tall=[11, 41], texels=128, rays=256)
    settings = parser.parse_args()
    folder = settings.data or data_folder()
    flat, tall = (
        [maze(count, seed=0, layers=layers) for count in counts]
        for layers, counts in ((1, settings.blocks), (LAYERS, settings.tall))
    )
    dictionary = timed(2)
    spectra()
    found = [study(level, dictionary, settings, folder) for level in flat]
    dictionary = timed(3)
    found += [study(level, dictionary, settings, folder) for level in (*tall, HALL)]
    heads = (
        "blocks",
        "layers",
        "bounces",
        "modular",
        "operator-ridge b64",
        "ambient",
        "energy, modular / traced",
        "noise",
    )
    table(heads, [row for rows, _ in found for row in rows])
    draw(settings.out, *found[min(1, len(flat) - 1)][1])
    draw(settings.out.with_stem(settings.out.stem + "_tall"), *found[-2][1])


def timed(dimension: int) -> Dictionary:
    """The dictionary of a dimension, built; says what that took."""
    started, spent = time.perf_counter(), time.process_time()
    dictionary = build(dimension=dimension)
    seconds, spent = time.perf_counter() - started, time.process_time() - spent
    print(
        f"dictionary of {len(dictionary.basis)} cubes: {seconds:.0f} s, {spent:.0f} s of processors,"
        f" {dictionary.bytes / 1e6:.1f} MB (paper, flat: 59 + 60 + 260 s on 12 cores, 4.7 + 1.2 MB)\n"
    )
    return dictionary


def spectra() -> None:
    """Singular values that hold most of the energy of the one-bounce operator, of direct light, and of both together."""
    transport, light = one_bounce(16), direct_light(16, (), 63)
    prior, weights = enriched([light], 64)
    values = {
        "F": np.linalg.svd(transport, compute_uv=False),
        "L": np.linalg.svd(light, compute_uv=False),
        "M": np.linalg.svd(transport @ (prior * weights), compute_uv=False),
    }
    told = [
        (name, *(f"{needed(values[name], share)} ({PAPER[name][i]})" for i, share in enumerate(SHARES)))
        for name in PAPER
    ]
    table(("closed cube, 6 × 16² (paper)", "80 %", "90 %", "95 %"), told)
    print()


def study(level: Level, dictionary: Dictionary, settings, folder) -> tuple[list[tuple], tuple]:
    """One maze: rows of the table for one bounce and for all, and what is drawn of it."""
    scene, cells = scene_of(level, ALBEDO), np.array(level.cells)
    count, layers = len(cells), len(np.unique(cells[:, 1]))
    ds = prt.bake(
        scene, "point", 128, settings.texels, settings.rays, 16 * count, seed=0, out=folder, supersampling=1
    )  # fmt: skip
    random = np.random.default_rng(1)
    places = EDGE * (cells[random.integers(0, count, LIT)] + random.uniform(-0.35, 0.35, (LIT, 3)))
    lightings = [prt.Lighting([prt.PointLight(place, (20.0, 19.0, 17.0))]) for place in places]
    lit = prt.light(ds, lightings)
    direct = direct_irradiance(Tracer(scene), block_samples(level, dictionary.side), emitters(lightings))
    direct = np.moveaxis(direct.reshape(LIT, count, -1, 3), 0, 2).reshape(count, -1, 3 * LIT)
    model = transfer(level, dictionary)
    albedo = np.repeat(np.array(ALBEDO), dictionary.side**2, axis=0)[None] * np.asarray(model.solid)[:, :, None]
    spread = level.interpolation(ds.points.position / EDGE, ds.points.normal, dictionary.side)
    rows, pictures = [], ()
    transport = ds.transport
    once = np.asarray(
        indirect(transport.sample_gather(), jnp.asarray(ds.points.albedo, jnp.float32), jnp.asarray(lit.direct), 1)
    )
    for bounces, wanted in (("1", once), ("all", lit.indirect)):
        found = model(
            jnp.asarray(direct), jnp.tile(jnp.asarray(albedo), LIT), 1 if bounces == "1" else transport.bounces
        )
        flat = np.asarray(found).reshape(-1, LIT * 3)
        ours = np.moveaxis((spread @ flat).reshape(-1, LIT, 3), 1, 0)
        ridge, ambient = "", ambient_error(lit.direct, wanted)
        if bounces == "all":
            fitted = prt.method("operator-ridge", basis=64).fit(ds.split("train"))
            ridge = f"{relative_rmse(np.asarray(fitted.predict(lit)), wanted):.3f}"
            pictures = (ds, wanted[0], ours[0])
        noise = f"{np.median(lit.noise):.3f}" if bounces == "all" else ""
        energy = f"{ours.mean() / wanted.mean():.3f}"
        error = f"{relative_rmse(ours, wanted):.3f}"
        rows.append((count, layers, bounces, error, ridge, f"{ambient:.3f}", energy, noise))
    return rows, pictures


def ambient_error(direct: np.ndarray, wanted: np.ndarray) -> float | None:
    """Of the mean direct light times one factor, chosen with the answer known."""
    term = np.broadcast_to(direct.mean(axis=1, keepdims=True), wanted.shape)
    return relative_rmse(np.sum(term * wanted) / np.sum(term * term) * term, wanted)


def draw(path: Path, ds: prt.LightingDataset, wanted: np.ndarray, found: np.ndarray) -> None:
    """The floors from above under the first lighting, the lowest on top: each pixel the nearest texel."""
    floor = ds.points.normal[:, 1] > 0.5
    place = ds.points.position[floor] / EDGE
    storey = np.rint(place[:, 1] + 0.5).astype(int)
    low, high = place.min(axis=0), place.max(axis=0)
    x, z = (np.arange(low[axis], high[axis], 1.0 / PIXELS) for axis in (0, 2))
    top = np.quantile(wanted[floor], 0.99)
    parts = {
        "traced": np.clip(wanted / top, 0, 1) ** (1 / 2.2),
        "modular": np.clip(found / top, 0, 1) ** (1 / 2.2),
        "difference × 4": np.clip(0.5 + 4.0 * (found - wanted) / top, 0, 1),
    }
    panels: dict[str, list[np.ndarray]] = {title: [] for title in parts}
    for layer in np.unique(storey):
        rows = np.flatnonzero(floor)[storey == layer]
        away, nearest = KDTree(place[storey == layer][:, [0, 2]]).query(np.stack(np.meshgrid(x, z), axis=-1))
        for title, light in parts.items():
            panels[title].append(np.where((away < 0.1)[..., None], light[rows][nearest], 1.0))
            panels[title].append(np.ones((PIXELS // 4, len(x), 3)))
    whole = {title: np.concatenate(images[:-1]) for title, images in panels.items()}
    floors(path, whole, 4 * len(whole["traced"]) / len(x) + 0.5)


if __name__ == "__main__":
    main()
