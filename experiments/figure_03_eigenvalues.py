"""Relative eigenvalues of the indirect light's autocorrelation (Figure 3 of Belcour et al. 2022), on our scenes.

128 lightings a scene, all channels as examples, about the mean as in the paper. Each is over the size of its indirect light:
over the norm of its measured light, the paper's choice, one spot that misses the measurement points is all there is.
Prints how many eigenvalues exceed 1 % of the first and how many hold 90, 95 and 99 % of the energy; draws the curves.

    python experiments/figure_03_eigenvalues.py [--scenes cornell suzanne bunny] [--scenarios point spot] [--data DIR]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from prt_bench.linalg import leading_basis
from prt_bench.methods.examples import normalised
from prt_bench.store import data_folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["cornell", "suzanne", "bunny"])
    parser.add_argument("--scenarios", nargs="+", default=["point", "spot"])
    parser.add_argument("--data", type=Path, default=None, help="where bakes are kept")
    parser.add_argument("--out", type=Path, default=Path("experiments/figures/figure_03.png"))
    settings = parser.parse_args()

    figure, axes = plt.subplots(figsize=(6.5, 3.8), dpi=120, layout="constrained")
    print("| scene | scenario | above 1 % of the first | for 90 % | 95 % | 99 % of the energy |")
    print("|---|---|---|---|---|---|")
    for colour, scene in zip(("#0072B2", "#D55E00", "#009E73", "#CC79A7"), settings.scenes, strict=False):
        for style, scenario in zip(("-", "--", ":"), settings.scenarios, strict=False):
            values = eigenvalues(scene, scenario, settings.data or data_folder())
            share = np.cumsum(values) / np.sum(values)
            counts = [int(np.searchsorted(share, part)) + 1 for part in (0.90, 0.95, 0.99)]
            print(
                f"| {scene} | {scenario} | {np.sum(values > 0.01 * values[0])} | " + " | ".join(map(str, counts)) + " |"
            )
            axes.semilogy(
                np.arange(1, 65), 100 * values[:64] / values[0], style, color=colour, label=f"{scene}, {scenario}"
            )
    axes.axhline(1.0, color="#666666", linewidth=0.8)
    axes.text(64, 1.08, "1 %", ha="right", va="bottom", color="#666666", fontsize=8)
    axes.set(xlabel="eigenvalue", ylabel="relative to the first, %", xlim=(1, 64))
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    settings.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(settings.out)


def eigenvalues(scene: str, scenario: str, folder: Path) -> np.ndarray:
    """Of the autocorrelation of the centred training light, descending."""
    ds = prt.bake(prt.load_scene(scene), scenario, 128, 128, 256, measurements=256, seed=0, out=folder)
    train = ds.split("train")
    examples = normalised(train.measured, train.indirect)
    examples = examples.less(*examples.means())
    return np.asarray(leading_basis(examples.y, 1, examples.floor)[1]) ** 2


if __name__ == "__main__":
    main()
