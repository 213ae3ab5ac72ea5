"""What each setting of the closed-form baseline does: one table per setting, all else as it was.

The settings are the practical details of the source paper (Belcour et al. 2022, sections 4 and 5): mono- or multi-channel
bases, supersampled measurement, measurement on the surface or on a hull, gamma space, mean, ridge, number of measurement
points, number of lightings. Where a setting is not the one varied it is: no mean, a matrix per channel, ridge 1e-3, 256
measured values of 8 samples each on the surface, 128 lightings.

Columns: relative RMSE on held-out lightings, and that of the reference projected on the same basis (in gamma space where the
model works there); the same error of lightmaps as displayed, max(0, y)^(1/2.2); the error of changes between frames under a
slowly moving light (`prt_bench.metrics.temporal_error`), and that of the projection; kilobytes of the asset in float32.

    python experiments/settings.py [--scene cornell] [--scenario point] [--basis 16 64] [--data FOLDER] [--out FOLDER]
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

import prt_bench as prt
from data_gen.tracer import Tracer
from prt_bench.gamma import GammaModel, curve, over, uncurve
from prt_bench.linalg import orthonormal
from prt_bench.metrics import relative_rmse, temporal_error
from prt_bench.models import Model, Observed, interleaved

FRAMES = 48
PATH = 0.15
"""Length of the moving light's path, relative to the scene's extent."""
LIGHTINGS = 128
SATURATED = np.array([[1.0, 0.05, 0.05], [0.05, 1.0, 0.05], [0.05, 0.05, 1.0]])
"""Colours that no scenario draws."""
HEAD = ("error", "its projection", "displayed", "temporal", "its projection", "kB")


@dataclass(frozen=True)
class Baked:
    """A bake's splits, and its scene under the moving light."""

    train: prt.LightingDataset
    test: prt.LightingDataset
    moving: prt.LightingDataset

    def first(self, lightings: int) -> "Baked":
        """With the first training lightings alone."""
        start, _ = self.train.rows
        return replace(self, train=replace(self.train, rows=(start, start + lightings)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="cornell")
    parser.add_argument("--scenario", choices=("point", "spot"), default="point")
    parser.add_argument("--basis", type=int, nargs="+", default=[16, 64])
    parser.add_argument("--texels", type=int, default=64)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--data", type=Path, help="folder of the stores (default: $PRT_BENCH_DATA or the user's cache)")
    parser.add_argument("--out", type=Path, default=Path("runs/settings"), help="folder of the tables in Markdown")
    args = parser.parse_args()

    started = time.perf_counter()
    scene = prt.load_scene(args.scene)
    bake = partial(
        prt.bake, scene, args.scenario, lightings=2 * LIGHTINGS, texels=args.texels, rays=args.rays, out=args.data
    )
    path: list[prt.Lighting] = []

    @cache
    def baked(**settings: Any) -> Baked:
        ds = bake(**settings)
        path.extend([] if path else moving_light(ds.split("test")))
        return Baked(ds.split("train"), ds.split("test"), prt.light(ds, path))

    text = [f"# Settings of svd-ridge on {args.scene}, scenario {args.scenario}\n"]
    for size in args.basis:
        text.append(f"## {size} basis functions\n")
        for title, head, rows in tables(baked, size):
            print(f"{size} functions: {title}", flush=True)
            text += [f"### {title}\n", *table(head, rows), ""]
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / f"{args.scene}-{args.scenario}.md"
    file.write_text("\n".join(text), encoding="utf-8")
    print("\n".join(text))
    print(f"{file}, {time.perf_counter() - started:.0f} s")


def tables(baked: Callable[..., Baked], size: int) -> Iterator[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    """Title, head and rows for each setting."""
    plain = {"basis": size, "mean": False, "transfer": "per-channel"}
    method = partial(prt.method, "svd-ridge")
    whole = baked()
    base = whole.first(LIGHTINGS)

    rows = [(name, *figures(method(**{**plain, "transfer": name}).fit(base.train), base)) for name in
            ("shared", "per-channel", "coupled")]  # fmt: skip
    yield "Channels", ("transfer", *HEAD), rows
    white, saturated = recoloured(base.train, np.ones((1, 3))), recoloured(base.test, SATURATED)
    rows = []
    for name in ("shared", "per-channel", "coupled"):
        models = [method(**{**plain, "transfer": name}).fit(light) for light in (base.train, white)]
        rows.append((name, *(_figure(error(model, test)) for model in models for test in (base.test, saturated))))
    columns = ("transfer", "coloured → coloured", "coloured → saturated", "white → coloured", "white → saturated")
    yield "Colours of light: fitted under → tested under", columns, rows

    def varied(name: str, bakes: dict[str, Baked], **settings: Any) -> tuple[str, tuple[str, ...], list]:
        rows = [(key, *figures(method(**{**plain, **settings}).fit(part.train), part)) for key, part in bakes.items()]
        return name, (name.lower(), *HEAD), rows

    samples = {"1": baked(supersampling=1).first(LIGHTINGS), "8": base}
    yield varied("Samples per measured value", samples)
    yield varied("Measured on", {"surface": base, "hull": baked(measure_on="hull").first(LIGHTINGS)})
    for title, setting, values in (
        ("Gamma", "gamma", (1.0, 2.2)),
        ("Mean", "mean", (True, False)),
        ("Ridge", "ridge", (1e-4, 1e-3, 1e-2, 1e-1)),
    ):
        rows = [(f"{v:g}" if setting != "mean" else str(v), *figures(method(**{**plain, setting: v}).fit(base.train), base))
                for v in values]  # fmt: skip
        yield title, (setting, *HEAD), rows
    counts = {count: base if count == 256 else baked(measurements=count).first(LIGHTINGS) for count in
              (32, 64, 128, 256, 512)}  # fmt: skip
    yield varied("Measured values", {str(count): part for count, part in counts.items()})
    yield varied("Lightings", {str(count): whole.first(count) for count in (16, 32, 64, 128, 256)})


def figures(model: Model, on: Baked) -> tuple[str, ...]:
    """The columns of `HEAD`, of the asset that ships."""
    with TemporaryDirectory() as folder:
        asset = model.export(Path(folder) / "asset")
        predicted = asset.predict(on.test)
        return (
            _figure(relative_rmse(predicted, on.test.indirect)),
            _figure(relative_rmse(projected(model, on.test), on.test.indirect)),
            _figure(relative_rmse(displayed(predicted), displayed(on.test.indirect))),
            _figure(temporal_error(asset.predict(on.moving), on.moving.indirect)),
            _figure(temporal_error(projected(model, on.moving), on.moving.indirect)),
            f"{sum(asset.bytes.values()) / 1e3:.0f}",
        )


def error(model: Model, on: Observed) -> float | None:
    """Relative RMSE of a model's predictions."""
    return relative_rmse(np.asarray(model.predict(on)), on.indirect)


def projected(model: Model, ds: Observed) -> np.ndarray:
    """The reference projected on the model's basis, in gamma space where the model works there."""
    if not isinstance(model, GammaModel):
        return _onto(model.span, jnp.asarray(ds.indirect, float))
    size, (gamma, toe) = model.size(jnp.asarray(ds.measured, float)), model.gamma
    return np.asarray(size * uncurve(_onto(model.inside.span, curve(over(ds.indirect, size), gamma, toe)), gamma, toe))


def _onto(span: Any, light: Any) -> Any:
    columns = light if len(span) == light.shape[1] else interleaved(light)
    u = np.asarray(orthonormal(span))
    return np.einsum("tb,sb,nsc->ntc", u, u, np.asarray(columns), optimize=True).reshape(light.shape)


def displayed(light: np.ndarray) -> np.ndarray:
    """As a screen's gamma shows it, without its clipping of bright values."""
    return np.maximum(light, 0.0) ** (1 / 2.2)


def recoloured(ds: prt.LightingDataset, colours: np.ndarray) -> Any:
    """The lightings of a split in other colours, in turn: light is linear in each channel."""
    own = np.array([vars(lighting.lights[0])["intensity"] for lighting in ds.lightings])
    wanted = np.resize(colours, own.shape) * own.mean(axis=1, keepdims=True)
    factor = (wanted / own)[:, None]
    return SimpleNamespace(measured=ds.measured * factor, indirect=ds.indirect * factor)


def moving_light(test: prt.LightingDataset) -> list[prt.Lighting]:
    """The held-out light with most room around it, moving straight towards another one in sight, a little in each frame."""
    lights = [lighting.lights[0] for lighting in test.lightings]
    at = np.array([vars(light)["position"] for light in lights])
    tracer, length = Tracer(test.scene), PATH * test.scene.extent
    for first in np.argsort(-tracer.clearance(at)):
        apart = np.linalg.norm(at - at[first], axis=1)
        for other in np.flatnonzero(apart > length):
            way = (at[other] - at[first]) * (length / apart[other])
            if not tracer.occluded(at[None, first], way[None])[0]:
                steps = at[first] + np.linspace(0, 1, FRAMES)[:, None] * way
                return [prt.Lighting([replace(lights[first], position=tuple(step))]) for step in steps]
    raise SystemExit(f"no two held-out lights of '{test.scene.name}' are {length:.2f} m apart in sight of each other")


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Markdown lines."""
    return [f"| {' | '.join(line)} |" for line in (head, ("---",) * len(head), *rows)]


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


if __name__ == "__main__":
    main()
