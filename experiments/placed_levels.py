"""Blocks placed in real scenes by hand: the Cornell box, a great hall with a chapel, and a maze.

Every scene is baked with lamps all over it. On lightings held out, indirect light after all bounces is compared with the traced
operator's: one block for the scene (`modular`), the blocks of a level file (`experiments/levels`), `operator-ridge` of 64
functions fitted to the scene, and the mean direct light times the factor that fits best. All observe the same 512 measurement
points. Also told: bytes of the asset, seconds of the fit (blocks need no bake but points and albedo; their dictionary, built
once for all scenes, is there before the first is timed), and milliseconds of measuring, transfer and reconstruction in JAX for
one lighting.

    python experiments/placed_levels.py [--texels 96] [--rays 128] [--data FOLDER]

Draws the floor of the hall: traced, one block, four blocks.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
from _frames import arguments, floors, table
from modular import ambient_error
from scipy.spatial import KDTree

import prt_bench as prt
from data_gen.geometry import assemble, box, quad
from prt_bench.metrics import relative_rmse
from prt_bench.modular.placed import Placed
from prt_bench.scene import Camera, Material, Scene
from prt_bench.timing import time_stages

LEVELS = Path(__file__).parent / "levels"
PILLARS = ((3.0, 1.0), (3.0, 5.0), (9.0, 1.0), (15.0, 1.0), (15.0, 5.0))


def hall() -> Scene:
    """A nave of 18 × 6 × 6 m with five pillars and a carpet, and a chapel of 6 × 5 m behind the middle of one wall."""
    outline = [(0, 0), (0, 6), (6, 6), (6, 11), (12, 11), (12, 6), (18, 6), (18, 0)]
    materials = (
        Material("stone", (0.62, 0.58, 0.5)), Material("carpet", (0.6, 0.12, 0.1)),
        Material("plaster", (0.75, 0.74, 0.7)), Material("tiles", (0.2, 0.35, 0.6)),
    )  # fmt: skip
    parts = []
    for number, ((x0, z0), (x1, z1)) in enumerate(zip([*outline[1:], outline[0]], outline, strict=True)):
        corners = [(x0, 0, z0), (x1, 0, z1), (x1, 6, z1), (x0, 6, z0)]
        parts.append(quad(corners, 3 if number in (2, 3, 4) else 0))
    for (x0, x1, z0, z1), colour in (((0, 18, 0, 6), 1), ((6, 12, 6, 11), 0)):
        parts.append(quad([(x0, 0, z0), (x0, 0, z1), (x1, 0, z1), (x1, 0, z0)], colour))
        parts.append(quad([(x0, 6, z0), (x1, 6, z0), (x1, 6, z1), (x0, 6, z1)], 2))
    parts += [box((0.3, 3.0, 0.3), 0).transformed(np.eye(3), (x, 3.0, z)) for x, z in PILLARS]
    return Scene("great-hall", assemble(parts), materials, Camera((1.0, 3.0, 3.0), (12.0, 2.0, 4.0), fov_y=60.0))


def main() -> None:
    settings = arguments(__doc__, "placed_levels.webp", texels=96, rays=128).parse_args()
    prt.method("modular").dictionary()
    for scene in (hall(), prt.load_scene("cornell"), prt.load_scene("maze")):
        rows, picture = study(scene, settings)
        heads = ("error", "light, predicted / traced", "bytes", "fit, s", "measure + transfer + show, ms")
        table((scene.name, *heads), rows)
        print(flush=True)
        if scene.name == "great-hall":
            draw(settings.out, *picture)


def study(scene: Scene, settings) -> tuple[list[tuple], tuple]:
    """Rows of one scene, and what is drawn of it."""
    placed = Placed.load(LEVELS / f"{scene.name}.toml")
    ds = prt.bake(scene, "point", 64, settings.texels, settings.rays, 512, seed=0, out=settings.data)
    train, test = ds.split("train"), ds.split("test")
    fits = {
        "one block": lambda: prt.method("modular").fit(train),
        f"{len(placed.level.cells)} blocks": lambda: prt.method("modular", level=str(LEVELS)).fit(train),
        "operator-ridge b64": lambda: prt.method("operator-ridge", basis=64).fit(train),
    }
    models, seconds = {}, {}
    for name, fit in fits.items():
        started = time.perf_counter()
        models[name] = fit()
        jax.block_until_ready(jax.tree.leaves(models[name]))
        seconds[name] = time.perf_counter() - started
    with TemporaryDirectory() as kept:
        assets = {name: model.export(Path(kept) / name.replace(" ", "-")) for name, model in models.items()}
        timings = time_stages(assets, test)
        shown = {name: np.asarray(asset.predict(test)) for name, asset in assets.items()}
        rows = [
            (name, f"{relative_rmse(light, test.indirect):.3f}", f"{light.mean() / test.indirect.mean():.3f}",
             f"{sum(assets[name].bytes.values()) / 1e6:.1f} MB", f"{seconds[name]:.0f}",
             f"{sum(stage.median for stage in timings[name].stages.values()):.2f}")
            for name, light in shown.items()
        ]  # fmt: skip
    noise = f"{np.median(test.noise):.3f}"
    rows.append((f"ambient term (noise {noise})", f"{ambient_error(test.direct, test.indirect):.3f}", *("",) * 4))
    return rows, (ds, test.indirect[0], *(light[0] for light in list(shown.values())[:2]))


def draw(path: Path, ds: prt.LightingDataset, *lights: np.ndarray) -> None:
    """The floor from above: each pixel the nearest texel."""
    floor = (ds.points.normal[:, 1] > 0.5) & (ds.points.position[:, 1] < 0.1)
    place = ds.points.position[floor][:, [0, 2]]
    low, high = place.min(axis=0), place.max(axis=0)
    x, z = (np.linspace(low[axis], high[axis], round(24 * (high[axis] - low[axis]))) for axis in (0, 1))
    away, nearest = KDTree(place).query(np.stack(np.meshgrid(x, z), axis=-1))
    top = np.quantile(lights[0][floor], 0.99)
    panels = {
        title: np.where((away < 0.5)[..., None], np.clip(light[floor][nearest] / top, 0, 1) ** (1 / 2.2), 1.0)
        for title, light in zip(("traced", "one block", "four blocks"), lights, strict=True)
    }
    floors(path, panels, 3.0)


if __name__ == "__main__":
    main()
