"""Inverse lighting: where a light is, and how bright, from the indirect light alone that it causes.

A point light that no fit has seen lights the scene; given is the lightmap of its *indirect* light, and a fitted model of the
scene. Adam moves the light down the gradient of the relative squared error through lights → measured light → model, from
several starting places at once, drawn like the lights themselves. Its colour enters linearly and is solved for exactly at
every step. Visibility of the measurement points is traced again every few steps, for gradients do not reach it; `no shadows`
never traces it, and Nelder-Mead has no gradients but the same number of evaluations of the model for each light (each with
its own shadow rays).

Printed are the distance to the true place relative to the scene's extent, the share of lights found within 2 %, and the error
of the recovered intensity, over held-out lightings. An error of the model is an error of the answer: the rows are models.

    python experiments/inverse_light.py [--scene cornell] [--basis 64] [--lights 32] [--starts 8] [--steps 200] [--data FOLDER]
"""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from _descent import descend
from _frames import arguments, bake, table
from scipy.optimize import minimize

import prt_bench as prt
from data_gen.direct import visibility
from data_gen.scenarios import near_region, sample_lightings
from data_gen.tracer import Tracer
from prt_bench.emitters import Emitters, irradiance
from prt_bench.lights import PointLight
from prt_bench.linalg import orthonormal
from prt_bench.models import LinearModel

METHODS = ("operator-ridge", "reduced-rank", "svd-ridge")
RETRACED = 5
"""Steps between two tracings of visibility."""
FOUND = 0.02
COLUMNS = (
    "model",
    "its error",
    "by",
    "place, median",
    "place, 90 %",
    f"within {FOUND:.0%}",
    "intensity, median",
    "seconds",
)


class Problem:
    """Lights to be found from their indirect light, with one model of the scene; the light's fit is in coefficients."""

    def __init__(self, ds: prt.LightingDataset, model: LinearModel, wanted: np.ndarray, tracer: Tracer) -> None:
        basis = orthonormal(jnp.asarray(model.basis))
        self.ds, self.tracer, self.model = ds, tracer, model
        self.mixing = basis.T @ model.basis
        self.targets = jnp.einsum("tb,ltc->lbc", basis, wanted)
        self.size = jnp.sum(jnp.asarray(wanted) ** 2, axis=(1, 2))
        self.extent = float(ds.scene.extent)

    def answers(self, places: jax.Array, seen: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        """Coefficients [L, K, B, C] of white light of intensity 1 at each place, and the colour [L, K, C] that fits best."""
        points = self.ds.dense_points

        def measured(lit: Emitters, sees: jax.Array | None) -> jax.Array:
            light = irradiance(lit, points.position, points.normal, sees)
            return jnp.mean(light[self.ds.groups], axis=1)

        white = self.model.transfer(jax.vmap(measured)(_lights(places), seen))
        found = jnp.einsum("ab,nbc->nac", self.mixing, white).reshape(*places.shape[:2], -1, 3)
        along = jnp.sum(found * self.targets[:, None], axis=2)
        return found, jnp.maximum(along, 0.0) / jnp.maximum(jnp.sum(found**2, axis=2), 1e-30)

    def errors(self, places: jax.Array, seen: jax.Array | None = None) -> jax.Array:
        """Squared error [L, K] of each place's best colour, relative to the light that is given."""
        found, colour = self.answers(places, seen)
        rest = found * colour[:, :, None] - self.targets[:, None]
        return jnp.sum(rest**2, axis=(2, 3)) / self.size[:, None]

    def seen(self, places: jax.Array) -> jax.Array:
        """Which measurement points see each light."""
        return jnp.asarray(visibility(self.tracer, self.ds.dense_points, _lights(jnp.asarray(places))))


def _lights(places: jax.Array) -> Emitters:
    """White point lights of intensity 1, one for each place: what `prt_bench.chain` makes of a list of them, at once."""
    return jax.vmap(lambda place: PointLight(place, jnp.ones(3)).emitters())(places.reshape(-1, 3))


def by_gradient(problem: Problem, starts: np.ndarray, steps: int, shadows: bool = True) -> np.ndarray:
    """The place [L, 3] of least error among those that descent reaches from each start."""
    scale, low, high = problem.extent, *_inside(problem)

    def places(at: jax.Array) -> jax.Array:
        return jnp.clip(at * scale, low, high)

    end = descend(
        lambda at, seen: jnp.sum(jnp.log(problem.errors(places(at), seen) + 1e-6)), starts / scale, steps, 0.02,
        (lambda at: problem.seen(places(at))) if shadows else (lambda _: None), RETRACED,
    )  # fmt: skip
    return _best(problem, np.asarray(places(end)))


def by_nelder_mead(problem: Problem, starts: np.ndarray, steps: int) -> np.ndarray:
    """The same without gradients, one light and one start after the other."""
    low, high = _inside(problem)
    ends = np.array(starts)
    for light in range(len(starts)):
        one = jax.jit(lambda place, seen, light=light: _only(problem, light).errors(place[None, None], seen)[0, 0])

        def error(place: np.ndarray, one: Callable = one) -> float:
            inside = jnp.asarray(np.clip(place, low, high))
            return float(one(inside, problem.seen(inside)))

        for k, start in enumerate(starts[light]):
            ends[light, k] = minimize(error, start, method="Nelder-Mead", options={"maxfev": steps}).x
    return _best(problem, np.clip(ends, low, high))


def _only(problem: Problem, light: int) -> Problem:
    one = object.__new__(Problem)
    vars(one).update(vars(problem))
    one.targets, one.size = problem.targets[light : light + 1], problem.size[light : light + 1]
    return one


def _inside(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    low, high = near_region(problem.ds.scene)
    return low, high


def _best(problem: Problem, places: np.ndarray) -> np.ndarray:
    best = np.asarray(jnp.argmin(problem.errors(jnp.asarray(places), problem.seen(places)), axis=1))
    return places[np.arange(len(places)), best]


def main() -> None:
    parser = arguments(__doc__, "inverse_light.png", scene="cornell", basis=64, lights=32, starts=8, steps=200)
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    parser.add_argument("--without-gradients", action="store_true", help="also Nelder-Mead, which takes long")
    settings = parser.parse_args()
    ds = bake(settings.scene, "point", settings.data, streamed=2048)
    train, test, tracer = ds.split("train"), ds.split("test"), Tracer(ds.scene)
    chosen = test.lightings[: settings.lights]
    place = np.array([np.asarray(vars(each.lights[0])["position"]) for each in chosen])
    bright = np.array([np.asarray(vars(each.lights[0])["intensity"]) for each in chosen])
    low, high = near_region(ds.scene)
    drawn_alike = sample_lightings(ds.scene, "point", len(chosen) * settings.starts, [0, 9], tracer)
    starts = np.array([each.lights[0].position for each in drawn_alike]).reshape(len(chosen), settings.starts, 3)
    lines, drawn = [], {}
    for name in settings.methods:
        model = prt.method(name, basis=settings.basis).fit(train)
        own = float(np.linalg.norm(np.asarray(model.predict(test)) - test.indirect) / np.linalg.norm(test.indirect))
        problem = Problem(ds, model, test.indirect[: len(chosen)], tracer)
        ways = {"gradient": by_gradient, "gradient, no shadows": lambda *given: by_gradient(*given, shadows=False)}
        if settings.without_gradients:
            ways["Nelder-Mead"] = by_nelder_mead
        for way, solve in ways.items():
            started = time.perf_counter()
            found = solve(problem, starts, settings.steps)
            seconds = time.perf_counter() - started
            away = np.linalg.norm(found - place, axis=1) / ds.scene.extent
            colour = np.asarray(problem.answers(jnp.asarray(found)[:, None], problem.seen(found))[1])[:, 0]
            off = np.linalg.norm(colour - bright, axis=1) / np.linalg.norm(bright, axis=1)
            lines.append([name, f"{own:.3f}", way, f"{np.median(away):.2%}", f"{np.quantile(away, 0.9):.1%}",
                          f"{np.mean(away < FOUND):.0%}", f"{np.median(off):.1%}", f"{seconds:.0f}"])  # fmt: skip
            drawn[f"{name}, {way}"] = found
    table(COLUMNS, lines)
    draw(drawn, len(settings.methods), place, low, high, settings.out)


def draw(
    found: dict[str, np.ndarray], models: int, place: np.ndarray, low: np.ndarray, high: np.ndarray, out: Path
) -> None:
    """Recovered places and the true ones from the front: a column for each of the `models`, a row for each way."""
    ways = len(found) // models
    figure, panels = plt.subplots(
        ways, models, figsize=(3.2 * models, 3.3 * ways), squeeze=False, layout="constrained", sharex=True, sharey=True
    )
    for panel, (title, places) in zip(panels.T.ravel(), found.items(), strict=True):
        for a, b in zip(place, places, strict=True):
            panel.plot([a[0], b[0]], [a[1], b[1]], color="0.7", lw=1, zorder=1)
        panel.scatter(place[:, 0], place[:, 1], s=26, facecolors="none", edgecolors="k", label="true place")
        panel.scatter(places[:, 0], places[:, 1], s=9, color="tab:red", label="recovered")
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        panel.set_title(title, fontsize=9)
    for panel in panels[-1]:
        panel.set_xlabel("x in m")
    for panel in panels[:, 0]:
        panel.set_ylabel("y in m")
    panels[0, 0].legend(fontsize=7, loc="lower left")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=130)
    print(f"\n{out}")


if __name__ == "__main__":
    main()
