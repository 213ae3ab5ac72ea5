"""A hairball: its frame, its texture of strands and places along them (Figures 10 and 11 of Belcour et al. 2022).

Bakes `hairball` with as many strands as asked under point lights, fits `svd-ridge` as published, in gamma space and with a
matrix per channel, and `operator-ridge`. Prints cost, errors, bytes, and the share of the texture that strands fill. The first
picture has direct light, indirect light, their sum and the reference; the second the texture of the reference's indirect
light, a part of it with ten texels a strand, and the mean along strands: all, the brightest tenth and the darkest.

    python experiments/figure_10_hair.py [--strands 2000] [--scenario point] [--rays 64] [--lightings 128] [--basis 16]
        [--data DIR] [--texture FILE]
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from _frames import PUBLISHED, SIZE, Row, arguments, draw, flip_of, lit, median_lighting, strand_texels, table

import prt_bench as prt
from data_gen.scenes import hairball
from data_gen.strand_atlas import strand_rows
from prt_bench.images import exposure_for, tone_map
from prt_bench.metrics import relative_rmse
from prt_bench.runtime.runtime import Runtime
from prt_bench.strands import TEXELS

DRAWN = ("as published", "per channel")
_PART = 8  # strands in a row of the enlarged part, and three times as many rows


def main() -> None:
    parser = arguments(
        __doc__, "figure_10.webp", strands=2000, scenario="point", rays=64, lightings=128, basis=16, shadows=2048
    )
    parser.add_argument("--texture", type=Path, default=Path("experiments/figures/figure_11.webp"))
    settings = parser.parse_args()
    scene = hairball.build(settings.strands)
    texels = strand_texels(settings.strands)
    own = {"mean": False, "transfer": "per-channel", "normalise": "indirect"}
    methods = {
        "as published": prt.method("svd-ridge", basis=settings.basis, **PUBLISHED),
        "in gamma space": prt.method("svd-ridge", basis=settings.basis, gamma=2.2, **PUBLISHED),
        "per channel": prt.method("svd-ridge", basis=settings.basis, **own),
        "operator-ridge": prt.method("operator-ridge", basis=settings.basis),
    }
    with TemporaryDirectory() as folder:
        started, busy = time.perf_counter(), time.process_time()
        ds = prt.bake(
            scene, settings.scenario, settings.lightings, texels, settings.rays, out=settings.data or Path(folder)
        )
        seconds, busy = time.perf_counter() - started, time.process_time() - busy
        actual, test = ds.metadata["actual"], ds.split("test")
        print(f"{settings.strands} strands in {texels}² texels, {strand_rows(scene, texels)} rows of them; bake"
              f" {seconds:.0f} s, {busy:.0f} s of CPU, predicted {ds.metadata['predicted']['seconds']:.0f} s")  # fmt: skip
        print(f"{actual['gather_rays'] / 1e6:.0f} M gather rays, {actual['disk_bytes'] / 1e6:.0f} MB on disk,"
              f" {actual['memory_bytes'] / 1e6:.0f} MB in memory; noise floor {test.noise_floor:.3f}\n")  # fmt: skip
        lines, rows, index = [], [], None
        runtime = Runtime(ds, SIZE, shadow_resolution=settings.shadows)
        fibres = ds.points.clearance > 0  # pyright: ignore[reportOptionalOperand]
        for name, method in methods.items():
            asset = method.fit(ds.split("train")).export(Path(folder) / name.replace(" ", "-"))
            index = median_lighting(asset, test) if index is None else index
            found = np.asarray(asset.predict(test))
            shown, captions = lit(runtime, test, index, asset)
            lines.append((
                name, relative_rmse(found, test.indirect), relative_rmse(found[:, fibres], test.indirect[:, fibres]),
                flip_of(captions), f"{sum(asset.bytes.values()) / 1e6:.2f}",
            ))  # fmt: skip
            if name in DRAWN:
                rows.append(Row(name, shown, captions))
        table(("transfer", "error", "on hair", "FLIP", "MB"), lines)
        print(f"\ndrawn: held-out lighting {index}")
        draw(settings.out, rows)
        assert index is not None
        texture(settings.texture, ds, test.indirect[index], texels)


def texture(path: Path, ds: prt.LightingDataset, light: np.ndarray, texels: int) -> None:
    """The strands' part of a lightmap, some of it enlarged, and light along strands."""
    strands = light[ds.points.clearance > 0].reshape(-1, TEXELS, 3)  # pyright: ignore[reportOptionalOperand]
    rows = strand_rows(ds.scene, texels)
    across = texels // TEXELS
    image = np.zeros((rows * across, TEXELS, 3))
    image[: len(strands)] = strands
    image = image.reshape(rows, across * TEXELS, 3)
    exposure = exposure_for(image)
    figure, (whole, part, graph) = plt.subplots(
        1, 3, figsize=(9.4, 3.4), dpi=100, layout="constrained", width_ratios=(1.0, 1.0, 1.15)
    )
    low = rows // 2
    near = image[low : low + 3 * _PART, : _PART * TEXELS]
    for axes, shown, title in ((whole, image, "texture of all strands"), (part, near, "ten texels a strand")):
        axes.imshow(tone_map(shown, exposure), interpolation="nearest", aspect="auto")
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9)
    part.set_xticks(np.arange(0, _PART * TEXELS, TEXELS) - 0.5, [])
    part.set_xlabel(f"{_PART} strands of {3 * _PART} rows, root to tip", fontsize=8)
    whole.set_xlabel(f"{across} strands a row, {rows} rows", fontsize=8)
    mean = strands.mean(axis=(1, 2))
    order = np.argsort(mean)
    tenth = max(len(order) // 10, 1)
    for chosen, label in ((order[-tenth:], "brightest tenth"), (order, "all"), (order[:tenth], "darkest tenth")):
        graph.plot(np.arange(TEXELS), strands[chosen].mean(axis=(0, 2)), label=label)
    graph.set(xlabel="texel, from root to tip", ylabel="W/m²", yscale="log")
    graph.set_title("indirect light along strands", fontsize=9)
    graph.legend(fontsize=8)
    figure.savefig(path, pil_kwargs={"quality": 88} if path.suffix == ".webp" else None)
    print(f"picture: {path}")


if __name__ == "__main__":
    main()
