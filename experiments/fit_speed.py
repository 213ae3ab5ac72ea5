"""Seconds, CPU and memory of `svd-ridge` on a large lightmap, beside scikit-learn's PCA and Ridge.

Light is normalised as `svd-ridge` does by default, and the map is additive: 64 principal components, or 63 and the mean,
which PCA takes out, with a coefficient of its own; then ridge regression without intercept at the same λ. Three fits, each a
process of its own, in alternating rounds:

    blocks     svd-ridge with its default `memory`, so that the light is read in blocks
    memory     svd-ridge with `memory` above the light's size
    scikit     PCA(svd_solver="randomized") of float32 lightings, then Ridge

Counted is everything from light on disk to a model but for imports: reading, arranging, compiling, fitting. For scikit
PCA and Ridge alone are printed too, so that arranging its matrix is not held against it. Memory is the peak of the process,
and what of it imports had taken. Of PCA's solvers "randomized" is the fast one for so wide a matrix: "full" took 6.6 times
as long, and "covariance_eigh" needs the covariance of all texels. Errors of held-out lightings are computed by the same
code. The bake is kept in --out. Goals: 3 times as fast, with no more error.

    python experiments/fit_speed.py --out DIR [--texels 1024] [--lightings 128] [--rays 256] [--basis 64] [--rounds 3]
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from sklearn.decomposition import PCA
from sklearn.linear_model import Ridge

import prt_bench as prt
from prt_bench.dataset import LightingDataset
from prt_bench.methods.examples import column_scale, columns
from prt_bench.metrics import relative_norm, root_mean_square
from prt_bench.models import LinearModel

RIDGE = 1e-3
FITS = ("blocks", "memory", "scikit")


def clocks() -> np.ndarray:
    """Wall and CPU seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def peak() -> float:
    """Largest memory of this process so far, in GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def ours(train: LightingDataset, basis: int, in_memory: bool) -> LinearModel:
    memory = {"memory": 10**15} if in_memory else {}
    return prt.method("svd-ridge", basis=basis, ridge=RIDGE, mean=False, **memory).fit(train)


def scikit(train: LightingDataset, basis: int) -> tuple[LinearModel, np.ndarray]:
    """y = [components, mean] W x, and the seconds of PCA and Ridge alone."""
    x = columns(jnp.asarray(train.measured))
    y = np.moveaxis(train.indirect, 2, 1).reshape(x.shape[1], -1)
    norms = np.sqrt([np.vdot(row, row) for row in y])
    scale = np.asarray(column_scale(x, jnp.asarray(norms, float)[None], y.shape[1], "indirect")[0])[0]
    light = np.asarray(x * scale).T
    y *= scale[:, None].astype(np.float32)
    started = clocks()
    pca = PCA(basis - 1, svd_solver="randomized", random_state=0)
    targets = np.c_[pca.fit_transform(y), np.ones(len(y))]
    ridge = Ridge(alpha=RIDGE * np.sum(light**2) / light.shape[1], fit_intercept=False).fit(light, targets)
    seconds = clocks() - started
    functions = np.concatenate([pca.components_, pca.mean_[None]]).T
    return LinearModel(jnp.asarray(functions, float), jnp.pad(ridge.coef_, ((0, 0), (0, 1)))[None]), seconds


def fit_once(path: Path, name: str, basis: int) -> None:
    """One fit in this process; its figures as a line of JSON."""
    imports = peak()
    train = LightingDataset.open(path).split("train")
    started = clocks()
    alone = None
    if name == "scikit":
        model, alone = scikit(train, basis)
    else:
        model = ours(train, basis, name == "memory")
    model.basis.block_until_ready()
    spent = clocks() - started
    memory = peak()
    test = LightingDataset.open(path).split("test")
    u = model.transfer(jnp.asarray(test.measured, float))
    errors = [
        relative_norm(
            np.asarray(model.reconstruct(u[row : row + 1])) - test.indirect[row : row + 1], test.indirect[row : row + 1]
        )[0]
        for row in range(len(test))
    ]
    figures = {"memory": memory, "imports": imports, "error": root_mean_square(np.array(errors))}
    print(json.dumps({**figures, "seconds": spent.tolist(), "alone": (spent if alone is None else alone).tolist()}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder that keeps the bake")
    parser.add_argument("--texels", type=int, default=1024)
    parser.add_argument("--lightings", type=int, default=128)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--basis", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--fit", choices=FITS, help="fit once in this process, and print its figures alone")
    settings = parser.parse_args()

    ds = prt.bake(
        prt.load_scene("cornell"), "point", settings.lightings, settings.texels, settings.rays, 256, out=settings.out
    )
    assert ds.path is not None
    if settings.fit:
        fit_once(ds.path, settings.fit, settings.basis)
        return
    light = 4 * settings.lightings * len(ds.points) * ds.measured.shape[2]
    print(
        f"{len(ds.points)} of {settings.texels}² texels, {settings.lightings} lightings, {light / 1e9:.2f} GB of light"
    )
    taken = {name: [] for name in FITS}
    for _ in range(settings.rounds):
        for name in FITS:
            told = subprocess.run(
                [sys.executable, *sys.argv, "--fit", name], capture_output=True, text=True, check=True
            ).stdout
            taken[name].append(json.loads(told.splitlines()[-1]))
    middle = {
        name: {key: np.median([run[key] for run in runs], axis=0) for key in runs[0]} for name, runs in taken.items()
    }
    print(
        "fit       wall s   CPU s   peak GB (imports)   held-out error   scikit over it: wall, CPU   PCA + Ridge alone"
    )
    for name, found in middle.items():
        ratio, alone = (middle["scikit"][key] / found["seconds"] for key in ("seconds", "alone"))
        print(
            f"{name:8s} {found['seconds'][0]:7.1f} {found['seconds'][1]:7.1f} {found['memory']:9.2f} ({found['imports']:.2f})"
            f" {found['error']:20.6f} {ratio[0]:21.2f} {ratio[1]:6.2f} {alone[0]:13.2f} {alone[1]:6.2f}"
        )
    print(f"goal: 3 in wall time at no more error; medians of {settings.rounds} rounds on {os.cpu_count()} cores,")
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
