"""How small a network for the transfer of implicit scenes may be: width, depth and encoding against error, bytes and frames.

For each scene a bake of sampled surface points, networks fitted to them, and the relative RMSE in SH space at fresh points
that no network has seen, beside the error of the fresh points themselves (from the two halves of their rays, and against
followed paths at some of them). The smallest network that reaches --goal is named. Frames are timed in both runtimes,
fragment shader and compute pass, for every size, and drawn with the chosen one; each frame is compared with the model in JAX
at the places that the shader met.

    python experiments/neural_transfer.py [--scenes blend gyroid bulb suzanne] [--samples 8192] [--rays 256] [--goal 0.1]

Writes neural_transfer.json, .md and pictures to --out, and a figure beside the others.
"""

import argparse
import json
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import FixedLocator, NullLocator
from PIL import Image

import prt_bench as prt
from data_gen.implicit.bake import Baked, bake
from data_gen.implicit.reference import follow
from data_gen.implicit.scenes import SCENES, load_implicit
from prt_bench.glossy import Surface, TripleModel
from prt_bench.implicit.scene import ImplicitScene
from prt_bench.learned.fields import Encoding
from prt_bench.learned.transfer import FieldShape, TransferField, fit_transfer, open_vectors, relative_error
from prt_bench.lights import emitters
from prt_bench.runtime.context import renderer
from prt_bench.runtime.implicit import ImplicitRuntime
from prt_bench.timing import interleaved

ENCODINGS: tuple[Encoding, ...] = ("none", "frequency", "grid")
FOLLOWED = 64
LIGHTING = prt.Lighting(
    [
        prt.DirectionalLight((-0.6, -1.0, -0.5), (2.2, 2.1, 1.9)),
        prt.DirectionalLight((0.8, -0.5, -0.3), (0.3, 0.4, 0.7)),
    ]
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["blend", "gyroid"])
    parser.add_argument("--samples", type=int, default=8192)
    parser.add_argument("--fresh", type=int, default=1024)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--order", type=int, default=5)
    parser.add_argument("--widths", type=int, nargs="+", default=[16, 32, 64, 128])
    parser.add_argument("--depths", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--encodings", nargs="+", choices=ENCODINGS, default=ENCODINGS)
    parser.add_argument("--steps", type=int, default=FieldShape().steps)
    parser.add_argument("--goal", type=float, default=0.1, help="relative RMSE in SH space that a network must reach")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="of the timed frames")
    parser.add_argument("--timed", type=int, default=6, help="networks whose frames are timed, from small to large")
    parser.add_argument("--out", type=Path, default=Path("runs/neural_transfer"))
    parser.add_argument("--figure", type=Path, default=Path("experiments/figures/neural_transfer.webp"))
    settings = parser.parse_args()
    settings.out.mkdir(parents=True, exist_ok=True)
    found = {}
    for name in settings.scenes:
        found[name] = study(load_implicit(name), settings)
        (settings.out / "neural_transfer.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    text = "\n".join(line for name, study_ in found.items() for line in table(name, study_)) + "\n"
    (settings.out / "neural_transfer.md").write_text(text, encoding="utf-8")
    print(text)
    draw(settings.figure, found, settings)


def study(scene: ImplicitScene, settings: argparse.Namespace) -> dict:
    """Bake, fit every size, choose, time and draw."""
    started = time.perf_counter()
    baked = bake(scene, settings.samples, settings.rays, settings.order, settings.fresh)
    result: dict = {"bake_seconds": time.perf_counter() - started, "noise": baked.noise, "bounces": baked.bounces}
    result |= against_paths(scene, baked, settings.order)
    fresh = baked.fresh
    alone = np.asarray(open_vectors(jnp.asarray(fresh.normal), settings.order))[:, None]
    result["open"] = relative_error(alone * np.ones((1, fresh.vectors.shape[1], 1)), fresh.vectors)
    print(scene.name, {name: round(value, 4) for name, value in result.items()}, flush=True)
    rows, fields = [], []
    for encoding, depth, width in product(settings.encodings, settings.depths, settings.widths):
        shape = FieldShape(width, depth, encoding, settings.steps)
        field, seconds = fitted(baked, shape)
        rows.append(
            {
                "width": width, "depth": depth, "encoding": encoding, "bytes": field.bytes, "seconds": seconds,
                "error": error_at(field, fresh), "trained": error_at(field, baked.samples),
            }
        )  # fmt: skip
        fields.append(field)
        print(json.dumps(rows[-1]), flush=True)
    order = np.argsort([row["bytes"] for row in rows])
    reached = [at for at in order if rows[at]["error"] <= settings.goal]
    chosen = reached[0] if reached else int(np.argmin([row["error"] for row in rows]))
    result |= {"rows": rows, "chosen": int(chosen), "reached": bool(reached), "goal": settings.goal}
    timed = sorted({int(order[round(at)]) for at in np.linspace(0, len(order) - 1, settings.timed)} | {int(chosen)})
    result["device"] = add_frames(scene, rows, fields, timed, tuple(settings.size))
    result["picture"] = picture(scene, fields[chosen], settings)
    return result


def against_paths(scene: ImplicitScene, baked: Baked, order: int) -> dict[str, float]:
    """Error of the bake at some fresh points against paths that share nothing with it, and the paths' own noise."""
    fresh = baked.fresh
    reference = follow(scene, fresh.position[:FOLLOWED], fresh.normal[:FOLLOWED], order, 1024)
    vectors = np.roll(fresh.vectors[:FOLLOWED], 1, axis=1)
    size = np.linalg.norm(reference.mean)
    return {
        "against_paths": float(np.linalg.norm(vectors - reference.mean) / size),
        "noise_of_paths": float(np.linalg.norm(reference.error) / size),
    }


def fitted(baked: Baked, shape: FieldShape) -> tuple[TransferField, float]:
    """A field and the seconds of its training."""
    started = time.perf_counter()
    samples = baked.samples
    field, _ = fit_transfer(samples.position, samples.normal, samples.vectors, shape)
    return field, time.perf_counter() - started


def error_at(field: TransferField, points) -> float:
    """Relative RMSE in SH space."""
    place = jnp.asarray(points.position, jnp.float32), jnp.asarray(points.normal, jnp.float32)
    return relative_error(field(*place), points.vectors)


def add_frames(
    scene: ImplicitScene, rows: list[dict], fields: list[TransferField], timed: list[int], size: tuple[int, int]
) -> str:
    """Milliseconds of a frame by fragment shader and by compute pass, interleaved over all; the renderer's name."""
    runtimes = {
        (at, by): ImplicitRuntime(scene, fields[at], size, by, fixed=True)
        for at in timed
        for by in ("fragment", "compute")
    }
    context = next(iter(runtimes.values())).context
    lights = {key: runtime.light(LIGHTING) for key, runtime in runtimes.items()}

    def clock(key: tuple[int, str]) -> float:
        context.finish()
        started = time.perf_counter()
        runtimes[key].draw(lights[key])
        context.finish()
        return (time.perf_counter() - started) * 1e3

    for (at, by), stage in interleaved({key: key for key in runtimes}, clock, 5, 1).items():
        rows[at][by] = stage.median
    return renderer(context)


def picture(scene: ImplicitScene, field: TransferField, settings: argparse.Namespace) -> dict:
    """Draw the chosen network, and compare its frame with the model in JAX and its vectors with followed paths there."""
    runtime = ImplicitRuntime(scene, field, (480, 360), "compute", fixed=True)
    path = settings.out / f"{scene.name}.png"
    Image.fromarray(runtime.picture(LIGHTING)).save(path)
    frame, surface = runtime.frame(LIGHTING), runtime.surface()
    met = surface.part >= 0
    position, normal, part = surface.position[met], surface.normal[met], surface.part[met]
    vectors = field(jnp.asarray(position), jnp.asarray(normal))
    model = TripleModel(vectors, jnp.asarray(scene.bounds.mean(axis=0), jnp.float32))
    u = model.observe(jax.tree.map(lambda leaf: jnp.asarray(leaf[0], jnp.float32), emitters([LIGHTING])))
    towards = runtime.eye - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    lobes = scene.lobes[part].astype(np.float32)
    what = Surface(normal, scene.albedos[part].astype(np.float32), lobes[:, :3], lobes[:, 3])
    wanted = np.asarray(model.radiance(u, what, jnp.asarray(towards, jnp.float32)))[0]
    some = np.random.default_rng(0).choice(len(position), FOLLOWED, replace=False)
    reference = follow(scene, position[some], scene.normal_at(position[some].astype(float)), settings.order, 1024)
    drawn = np.roll(np.asarray(vectors)[some], 1, axis=1)
    size = np.linalg.norm(reference.mean)
    return {
        "path": str(path),
        "gl_against_jax": float(np.linalg.norm(frame[met] - wanted) / np.linalg.norm(wanted)),
        "pixels_against_paths": float(np.linalg.norm(drawn - reference.mean) / size),
        "noise_of_paths": float(np.linalg.norm(reference.error) / size),
    }


def table(name: str, found: dict) -> list[str]:
    """Markdown: what the scene is, then a line per network on the frontier of bytes, and the timed ones."""
    chosen, rows = found["rows"][found["chosen"]], found["rows"]
    verb = "reaches" if found["reached"] else "comes nearest to"
    lines = [
        f"## {name}",
        "",
        f"Bake {found['bake_seconds']:.0f} s, {found['bounces']} bounces; noise of the fresh points {found['noise']:.3f}, bake"
        f" against followed paths {found['against_paths']:.3f} (their noise {found['noise_of_paths']:.3f}); an open surface"
        f" alone {found['open']:.3f}. Smallest network that {verb} {found['goal']}: {label(chosen)},"
        f" {chosen['bytes'] / 1e3:.0f} kB, error {chosen['error']:.3f}, trained in {chosen['seconds']:.0f} s."
        " Its frame against JAX"
        f" {found['picture']['gl_against_jax']:.1e}, its vectors at pixels against followed paths"
        f" {found['picture']['pixels_against_paths']:.3f} (their noise {found['picture']['noise_of_paths']:.3f})."
        f" Frames on {found['device']}.",
        "",
        "| network | kB | fresh error | training error | fit s | fragment ms | compute ms |",
        "|---|---|---|---|---|---|---|",
    ]
    best = np.inf
    for row in sorted(rows, key=lambda row: row["bytes"]):
        if row["error"] < best or "fragment" in row:
            cells = [label(row) + (" (frontier)" if row["error"] < best else ""), f"{row['bytes'] / 1e3:.0f}"]
            cells += [f"{row['error']:.3f}", f"{row['trained']:.3f}", f"{row['seconds']:.0f}"]
            cells += [f"{row[by]:.0f}" if by in row else "" for by in ("fragment", "compute")]
            lines.append("| " + " | ".join(cells) + " |")
        best = min(best, row["error"])
    return [*lines, ""]


def label(row: dict) -> str:
    """Width × depth and encoding."""
    return f"{row['width']}×{row['depth']} {row['encoding']}"


def draw(path: Path, found: dict, settings: argparse.Namespace) -> None:
    """Error against bytes, frame time against bytes, and the picture of each scene."""
    figure, grid = plt.subplots(len(found), 3, figsize=(12, 3.4 * len(found)), layout="constrained", squeeze=False)
    for line, (name, study_) in zip(grid, found.items(), strict=True):
        rows = study_["rows"]
        for encoding, colour in zip(ENCODINGS, ("tab:blue", "tab:orange", "tab:green"), strict=True):
            for depth, marker in zip((1, 2, 3), "ov^", strict=True):
                chosen = [row for row in rows if (row["encoding"], row["depth"]) == (encoding, depth)]
                if not chosen:
                    continue
                line[0].plot(
                    [row["bytes"] / 1e3 for row in chosen], [row["error"] for row in chosen], marker + "-", color=colour,
                    markersize=4, linewidth=1, label=f"{encoding}, depth {depth}",
                )  # fmt: skip
        line[0].axhline(study_["noise"], color="grey", linestyle=":", linewidth=1, label="noise of the points")
        line[0].axhline(study_["goal"], color="black", linestyle="--", linewidth=1, label="goal")
        line[0].set(xscale="log", yscale="log", ylabel=f"{name}: relative RMSE, fresh points")
        ticks_at(line[0].yaxis, (0.02, 0.05, 0.1, 0.2, 0.5))
        timed = sorted((row for row in rows if "fragment" in row), key=lambda row: row["bytes"])
        for by in ("fragment", "compute"):
            line[1].plot(
                [row["bytes"] / 1e3 for row in timed], [row[by] for row in timed], "o-", label=by, markersize=4
            )
        line[1].set(xscale="log", ylabel="ms of a frame")
        for plot in line[:2]:
            plot.set_xlabel("kB of the network")
            ticks_at(plot.xaxis, (5, 10, 20, 50, 100, 200))
        line[1].set_ylim(bottom=0)
        line[2].imshow(np.asarray(Image.open(study_["picture"]["path"])))
        line[2].set_title(f"{label(rows[study_['chosen']])}", fontsize=9)
        line[2].axis("off")
    grid[0, 0].legend(fontsize=6)
    grid[0, 1].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 88} if path.suffix == ".webp" else None)
    print(f"picture: {path}")


def ticks_at(axis: Axis, values: Sequence[float]) -> None:
    """Plain numbers on a logarithmic axis."""
    axis.set_major_locator(FixedLocator(list(values)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


if __name__ == "__main__":
    main()
