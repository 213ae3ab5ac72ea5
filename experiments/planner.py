"""What the planner leaves out of every built-in scene, what that saves, and what it changes; and what it predicts of the cost.

Each scene is baked as planned, then lit again by some of its held-out lightings with one thing after another in full
(`prt.skips`). Seconds, rays and bytes are counted up to the whole bake. The second table has what the plan predicted beside
what the bake took. Scenes whose mesh was not fetched are left out.

    python experiments/planner.py [--scenes cornell furnace …] [--texels 128] [--rays 256] [--lightings 128] [--measured 8]
        [--gather auto] [--gather_tolerance 0.05]
"""

from tempfile import TemporaryDirectory

from _frames import arguments, strand_texels, table

import prt_bench as prt
from prt_bench.errors import SceneError
from prt_bench.scene import Scene


def main() -> None:
    parser = arguments(
        __doc__, None, scenes=prt.scenes(), texels=128, rays=256, lightings=128, measured=8, gather="auto",
        gather_tolerance=0.05, scenario="point",
    )  # fmt: skip
    settings = parser.parse_args()
    skipped: list[list[object]] = []
    costs: list[list[object]] = []
    for name in settings.scenes:
        scene = loaded(name)
        if scene is None:
            continue
        with TemporaryDirectory() as folder:
            ds = prt.bake(
                scene, settings.scenario, settings.lightings, texels_of(scene, settings.texels), settings.rays,
                out=settings.data or folder,
                gather_texels=settings.gather if settings.gather == "auto" else int(settings.gather),
                gather_tolerance=settings.gather_tolerance,
            )  # fmt: skip
            skipped += [
                [
                    name,
                    skip.name,
                    skip.planned,
                    skip.full,
                    f"{skip.error:.2g}",
                    f"{skip.tolerance:g}",
                    "yes" if skip.error <= skip.tolerance else "no",
                    f"{skip.seconds:+.2f}",
                    f"{skip.rays / 1e6:+.2f}",
                    f"{skip.bytes / 1e6:+.1f}",
                ]
                for skip in prt.skips(ds, settings.measured)
            ]
            costs.append(cost(name, ds))
    print()
    table(
        (
            "scene",
            "left out",
            "planned",
            "in full",
            "error",
            "tolerance",
            "held",
            "s saved",
            "M rays saved",
            "MB saved",
        ),
        skipped,
    )
    print("\npredicted / actual\n")
    table(("scene", "M gather rays", "M shadow rays", "MB on disk", "MB in memory", "s"), costs)


def loaded(name: str) -> Scene | None:
    """A scene, or None where its mesh is not at hand."""
    try:
        return prt.load_scene(name)
    except SceneError as error:
        print(f"{name} is left out: {error}")
        return None


def texels_of(scene: Scene, texels: int) -> int:
    """As many as asked for, or what the scene's hair needs."""
    strands = 0 if scene.strands is None else len(scene.strands)
    return max(texels, strand_texels(strands))


def cost(name: str, ds: prt.LightingDataset) -> list[object]:
    """A line of predicted over actual cost."""
    predicted, actual = ds.metadata["predicted"], ds.metadata["actual"]
    scales = {"gather_rays": 1e6, "shadow_rays": 1e6, "disk_bytes": 1e6, "memory_bytes": 1e6, "seconds": 1.0}
    return [name, *(f"{predicted[key] / scale:.1f} / {actual[key] / scale:.1f}" for key, scale in scales.items())]


if __name__ == "__main__":
    main()
