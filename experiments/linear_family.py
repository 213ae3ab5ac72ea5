"""How close the closed-form family comes to its own basis, and how far it leads the published baseline.

For each scene and scenario: relative RMSE on held-out lightings, the projection error of the row's own basis, their ratio
(goal: at most 1.1 for the best row), and the published `svd-ridge`'s error over the row's, in scenario and out of it (goal: at
least 3 near point lights and out of scenario). Rows of one size cost the same at run time. The projection of the training
light's components is printed as `projection`: a row may come closer than it with a basis of its own.

    python experiments/linear_family.py [--scenes cornell suzanne bunny] [--scenarios point spot] [--data DIR]

`bunny` needs `make assets` once. Writes linear_family.md and .json to --out.
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import prt_bench as prt
from prt_bench.evaluate import errors
from prt_bench.store import data_folder

ROWS = (
    ("svd-ridge", {}),
    ("svd-ridge", {"mean": False, "transfer": "per-channel"}),
    ("operator-ridge", {}),
    ("operator-ridge", {"patterns": "surface"}),
    ("streamed-ridge", {}),
    ("reduced-rank", {}),
    ("projection", {}),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["cornell", "suzanne", "bunny"])
    parser.add_argument("--scenarios", nargs="+", default=["point", "spot"])
    parser.add_argument("--basis", type=int, nargs="+", default=[16, 64])
    parser.add_argument("--texels", type=int, default=128)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--streamed", type=int, default=2048)
    parser.add_argument("--data", type=Path, default=None, help="where bakes are kept")
    parser.add_argument("--out", type=Path, default=Path("runs/linear_family"))
    settings = parser.parse_args()
    warnings.simplefilter("ignore")  # the projection of a scene with few components

    rows = []
    for scene in settings.scenes:
        for scenario in settings.scenarios:
            rows += study(scene, scenario, settings)
    settings.out.mkdir(parents=True, exist_ok=True)
    (settings.out / "linear_family.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    (settings.out / "linear_family.md").write_text("\n".join(table(rows)) + "\n", encoding="utf-8")
    print(f"written to {settings.out}")


def study(scene: str, scenario: str, settings: argparse.Namespace) -> list[dict]:
    """All rows of one scene and scenario, printed as they come."""
    ood = tuple(name for name in ("point", "spot", "directional") if name != scenario)
    ds = prt.bake(
        prt.load_scene(scene), scenario, 128, settings.texels, settings.rays, measurements=256, seed=0,
        out=settings.data or data_folder(), ood=ood, streamed=settings.streamed,
    )  # fmt: skip
    train, rows = ds.split("train"), []
    for basis in settings.basis:
        published: dict[str, float] = {}
        for name, options in ROWS:
            method = prt.method(name, basis=basis, **options)
            started = time.perf_counter()
            model = method.fit(train)
            seconds = time.perf_counter() - started
            row = {"scene": scene, "scenario": scenario, "label": method.label, "fit_seconds": seconds, "splits": {}}
            for split in ("test", *(f"ood-{other}" for other in ood)):
                found = errors(model, ds.split(split))
                published.setdefault(split, found.relative_rmse)
                row["splits"][split] = {
                    "relative_rmse": found.relative_rmse,
                    "projection": found.projection,
                    "noise_floor": found.noise_floor,
                    "published_over_this": published[split] / found.relative_rmse,
                }
            rows.append(row)
            print("\n".join(table([row])[2 if len(rows) > 1 else 0 :]), flush=True)
    return rows


def table(rows: list[dict]) -> list[str]:
    """Markdown: one line per row."""
    lines = [
        "| scene | scenario | row | e_rec | e_proj | ratio | published / this | out of scenario: e_rec (published / this) |",
        "|" + "---|" * 8,
    ]
    for row in rows:
        test = row["splits"]["test"]
        others = ", ".join(
            f"{split.removeprefix('ood-')} {found['relative_rmse']:.3f} ({found['published_over_this']:.1f}x)"
            for split, found in row["splits"].items()
            if split != "test"
        )
        lines.append(
            f"| {row['scene']} | {row['scenario']} | {row['label']} | {test['relative_rmse']:.3f}"
            f" | {test['projection']:.3f} | {test['relative_rmse'] / test['projection']:.2f}"
            f" | {test['published_over_this']:.1f}x | {others} |"
        )
    return lines


if __name__ == "__main__":
    main()
