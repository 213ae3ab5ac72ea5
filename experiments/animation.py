"""One basis over the keyframes of an animation, with one transfer matrix for all of them or one for each.

The source paper builds a database of random keyframes with random lightings, takes a single basis that works across the
keyframes, and then either one transfer matrix per keyframe or one for the whole animation; it reports that the latter worked
well in practice, for subsurface scattering (Belcour et al. 2022, "Working with Animated Assets"; it gives no figures). Here
both are measured for diffuse interreflection, on an arm that bends and turns in a coloured room.

Keyframes at random times are each traced once and lit by lightings of their own. Errors are on lightings held out: at the
keyframes, and at times half-way between them, where the matrices of the two keyframes around are blended. `separate` is a
basis and a matrix for each keyframe, fitted on its own; between keyframes the predictions of two such models are blended,
which costs two reconstructions. Seconds of fits are CPU seconds of all cores, without compilation.

    python experiments/animation.py [--keyframes 12] [--lightings 32] [--basis 16 64] [--figure FILE] [--data FOLDER]
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import matplotlib.pyplot as plt
import numpy as np

import prt_bench as prt
from data_gen.scenes.arm import ARM
from prt_bench.animation import KeyframeModel, common_basis, hat_blend
from prt_bench.errors import RuntimeUnavailable
from prt_bench.methods.base import Method
from prt_bench.metrics import relative_norm, root_mean_square
from prt_bench.models import LinearModel, Model, ProjectionModel

T = TypeVar("T")
FRAMES = 6
LAMP = prt.Lighting([prt.PointLight(position=(-0.3, 1.65, 0.45), intensity=(9.0, 8.4, 7.2))])


@dataclass(frozen=True)
class Row:
    """A way to serve the clip: a model per keyframe, one for any blend of keyframes, numbers stored, CPU seconds to fit."""

    name: str
    at_keyframe: Callable[[int], Model]
    between: Callable[[np.ndarray], Callable[[prt.LightingDataset], np.ndarray]]
    numbers: int | None
    seconds: float | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keyframes", type=int, default=12)
    parser.add_argument("--lightings", type=int, default=32, help="training lightings of each keyframe")
    parser.add_argument("--basis", type=int, nargs="+", default=[16, 64])
    parser.add_argument("--scenario", default="point")
    parser.add_argument("--texels", type=int, default=96)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, help="folder of the stores (default: $PRT_BENCH_DATA or the user's cache)")
    parser.add_argument("--figure", type=Path, default=Path("experiments/figures/animation.png"))
    args = parser.parse_args()

    times = prt.keyframe_times(args.keyframes, args.seed)
    gaps = np.diff(times, append=times[0] + 1.0)
    halfway = (times + 0.5 * gaps) % 1.0
    settings = {"scenario": args.scenario, "texels": args.texels, "rays": args.rays, "out": args.data}
    started = time.perf_counter()
    clip = prt.bake_animation(
        [prt.load_scene("arm", t) for t in times], lightings=args.lightings, seed=args.seed, **settings
    )
    between = prt.bake_animation(
        [prt.load_scene("arm", t) for t in halfway], lightings=1, seed=args.seed + 1, layout=clip[0], **settings
    ).split("test")
    train, test = clip.split("train"), clip.split("test")
    print(
        f"{len(clip)} keyframes × {args.lightings} training lightings ({args.scenario}), {len(clip[0].points)} texels,"
    )
    print(
        f"{test[0].measured.shape[1]} measured values, {args.rays} rays; bakes took {time.perf_counter() - started:.0f} s"
    )
    print(f"noise floor {test.noise_floor:.3f} at the keyframes, {between.noise_floor:.3f} between\n")

    on_arm = clip[0].scene.mesh.material[clip[0].points.face] == ARM
    blends = [hat_blend(t, times) for t in halfway]
    print("| basis | method | transfer | keyframes | room | arm | between | storage MB | fit CPU s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for count in args.basis:
        for row in rows(train, count):
            at = [np.asarray(row.at_keyframe(k).predict(ds)) for k, ds in enumerate(test)]
            mixed = [row.between(blend)(ds) for blend, ds in zip(blends, between, strict=True)]
            figures = [error(at, test), error(at, test, ~on_arm), error(at, test, on_arm), error(mixed, between)]
            storage = "–" if row.numbers is None else f"{4e-6 * row.numbers:.2f}"
            seconds = "–" if row.seconds is None else f"{row.seconds:.2f}"
            print(
                f"| {count} | {row.name} | {' | '.join(f'{f:.3f}' for f in figures)} | {storage} | {seconds} |",
                flush=True,
            )

    draw(args.figure, prt.fit_keyframes(operator_ridge(max(args.basis)), train), between, blends)


def rows(train: prt.Clip, count: int) -> Iterator[Row]:
    """Everything that is compared at one size of the basis."""
    oracle = ProjectionModel(common_basis(train, count))
    yield Row("projection | oracle", lambda _: oracle, lambda _: _predicting(oracle), None, None)
    first = prt.Clip((train[0],))
    for label, method in {
        "svd-ridge": prt.method("svd-ridge", basis=count),
        "svd-ridge mean=False per-channel": prt.method("svd-ridge", basis=count, mean=False, transfer="per-channel"),
        "operator-ridge": operator_ridge(count),
    }.items():
        model, seconds = timed(lambda clip, method=method: prt.fit_keyframes(method, clip), train, first)
        if method.name == "svd-ridge":  # needs pairs of light alone, so a clip is as good as a dataset
            yield one_model(f"{label} | one for all", *timed(method.fit, train, train))
        else:
            even = np.full(len(train), 1.0 / len(train))
            yield one_model(f"{label} | mean of the matrices", model.at(even), seconds)
        size = model.basis.size + model.weights.size
        yield Row(f"{label} | per keyframe", model.keyframe, lambda b, m=model: _predicting(m.at(b)), size, seconds)
        apart, seconds = timed(lambda clip, method=method: [method.fit(ds) for ds in clip], train, first)
        size = sum(numbers(m) for m in apart)
        yield Row(f"{label} | separate", apart.__getitem__, lambda b, m=apart: _mixing(m, b), size, seconds)


def operator_ridge(count: int) -> Method:
    """With set values of ridge and prior, so that the table stays what it is."""
    return prt.method("operator-ridge", basis=count, ridge=3e-2, prior=0.5)


def timed(fit: Callable[[prt.Clip], T], clip: prt.Clip, warm_up: prt.Clip) -> tuple[T, float]:
    """The fit to a clip and its CPU seconds, once a fit to `warm_up` has compiled what it needs."""
    fit(warm_up)
    started = time.process_time()
    result = fit(clip)
    return result, time.process_time() - started


def one_model(name: str, model: LinearModel, seconds: float) -> Row:
    """A row of one basis and one matrix, whatever the pose."""
    return Row(name, lambda _: model, lambda _: _predicting(model), numbers(model), seconds)


def numbers(model: LinearModel) -> int:
    """How many numbers a model stores."""
    return model.basis.size + model.weights.size


def error(predictions: list[np.ndarray], clip: prt.Clip, where: np.ndarray | slice = slice(None)) -> float:
    """Relative RMSE over all lightings of a clip, on some receivers."""
    pairs = ((p[:, where], ds.indirect[:, where]) for p, ds in zip(predictions, clip, strict=True))
    return root_mean_square(np.concatenate([relative_norm(p - y, y) for p, y in pairs])) or 0.0


def draw(path: Path, model: KeyframeModel, between: prt.Clip, blends: Sequence[np.ndarray]) -> None:
    """A strip of frames between keyframes under one lamp: direct light, then indirect light of the reference and of ours."""
    from prt_bench.images import exposure_for, tone_map
    from prt_bench.runtime.runtime import Runtime

    count = min(FRAMES, len(between))
    figure, grid = plt.subplots(3, count, figsize=(2.0 * count, 6.4), dpi=110, layout="constrained", squeeze=False)
    exposure, errors = 0.0, []
    for column, index in zip(grid.T, np.linspace(0, len(between), count, endpoint=False).astype(int), strict=True):
        ds = prt.light(between[int(index)], [LAMP])
        prediction = np.asarray(model.at(blends[index]).predict(ds))
        errors.append(float(relative_norm(prediction - ds.indirect, ds.indirect)[0]))
        try:
            runtime = Runtime(ds, size=(360, 360))
        except RuntimeUnavailable as reason:
            print(f"no figure: {reason}")
            return
        lightmaps = [runtime.lightmap(light[0]) for light in (ds.indirect, prediction)]
        frames = [runtime.frame(LAMP), *(runtime.frame(LAMP, lightmap, direct=False) for lightmap in lightmaps)]
        exposure = exposure or exposure_for(frames[0], quantile=0.9)
        for axes, frame in zip(column, frames, strict=True):
            axes.imshow(tone_map(frame, exposure))
            axes.set(xticks=[], yticks=[])
        column[2].set_xlabel(f"error {errors[-1]:.1%}", fontsize=9)
    labels = ("direct", "indirect, reference", f"indirect, {model.basis.shape[1]} functions")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    print(f"\n{path}: errors of its frames, all between keyframes, {', '.join(f'{e:.3f}' for e in errors)}")


def _predicting(model: Model) -> Callable[[prt.LightingDataset], np.ndarray]:
    return lambda ds: np.asarray(model.predict(ds))


def _mixing(models: Sequence[Model], blend: np.ndarray) -> Callable[[prt.LightingDataset], np.ndarray]:
    return lambda ds: sum(w * np.asarray(m.predict(ds)) for w, m in zip(blend, models, strict=True) if w)  # pyright: ignore


if __name__ == "__main__":
    main()
