"""How far the traced operator's indirect light is from mitsuba's, by bounces, rays and texels.

For each setting: the relative RMSE over lightmap texels and several point lights in a Cornell box, with mitsuba's noise
taken out by two independent halves, and its uncertainty (one standard error). Goal: at most 1 % at 128² texels and 1024
rays, all bounces. Texels are drawn at random; `--points 0` takes all.

    python experiments/accuracy_vs_mitsuba.py [--texels 32 64 128] [--rays 64 256 1024] [--points 1500] [--paths 1024]
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from data_gen.bake import trace
from data_gen.plan import plan
from data_gen.scenes import load_scene
from data_gen.tracer import Tracer
from prt_bench.lights import Lighting, PointLight
from tests.oracles.mitsuba_oracle import MitsubaOracle
from tests.oracles.operator_light import operator_light, squared_error

INTENSITY = (3.0, 2.0, 1.0)
PLACES = ([0.4, 1.5, 0.2], [-0.6, 1.2, 0.6], [0.7, 0.9, -0.3])
BOUNCES = (1, 2, None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--texels", type=int, nargs="+", default=[32, 64, 128])
    parser.add_argument("--rays", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--points", type=int, default=1500)
    parser.add_argument("--paths", type=int, default=1024, help="of mitsuba, per texel and half")
    parser.add_argument("--out", type=Path, default=Path("runs/accuracy_vs_mitsuba"))
    settings = parser.parse_args()

    scene = load_scene("cornell")
    oracle = MitsubaOracle(scene)
    tracer = Tracer(scene)
    lightings = [Lighting([PointLight(place, INTENSITY, 0.0)]) for place in PLACES]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for texels in settings.texels:
            transports = {
                rays: trace(scene, plan(scene, texels=texels, rays=rays), 0, Path(folder), tracer)
                for rays in settings.rays
            }
            points = transports[settings.rays[0]].receivers
            chosen = np.random.default_rng(texels).permutation(len(points))[: settings.points or None]
            place = points.position[chosen], points.normal[chosen]
            for bounces in BOUNCES:
                halves = [
                    [oracle.indirect_irradiance(*place, lighting, settings.paths, bounces, seed) for seed in (1, 2)]
                    for lighting in lightings
                ]
                for rays, transport in transports.items():
                    _, found = operator_light(transport, lightings, bounces)
                    pairs = zip(found[:, chosen], halves, strict=True)
                    squares = np.array([squared_error(estimate, *oracles) for estimate, oracles in pairs])
                    rows.append(row(texels, rays, bounces, squares))
                    print(line(rows[-1]), flush=True)

    table = "\n".join(
        ["| texels | rays | bounces | relative RMSE % | ± | per light % |", "|" + "---|" * 6, *map(line, rows)]
    )
    settings.out.mkdir(parents=True, exist_ok=True)
    (settings.out / "accuracy.md").write_text(table + "\n", encoding="utf-8")
    (settings.out / "accuracy.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(f"written to {settings.out}")


def row(texels: int, rays: int, bounces: int | None, squares: np.ndarray) -> dict:
    """Errors over all lights, from each light's squared error and its standard error."""
    square, uncertainty = squares[:, 0].mean(), np.hypot.reduce(squares[:, 1]) / len(squares)
    # One standard error of the square, carried through the root: an error lost in mitsuba's noise has it as its bound.
    error, above = np.sqrt(np.maximum([square, square + uncertainty], 0.0))
    each = np.sqrt(np.maximum(squares[:, 0], 0.0)).tolist()
    return {
        "texels": texels,
        "rays": rays,
        "bounces": bounces,
        "relative_rmse": float(error),
        "standard_error": float(above - error),
        "per_light": each,
    }


def line(row: dict) -> str:
    each = ", ".join(f"{100 * error:.2f}" for error in row["per_light"])
    return (
        f"| {row['texels']}² | {row['rays']} | {row['bounces'] or 'all'} | {100 * row['relative_rmse']:.2f}"
        f" | {100 * row['standard_error']:.2f} | {each} |"
    )


if __name__ == "__main__":
    main()
