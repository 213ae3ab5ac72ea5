"""Where to measure: points and weights of the measured light, chosen by the gradient of the error on lightings kept aside.

The error of a ridge regression, fitted to some lightings and judged on others, is a function of where light is measured:
irradiance is differentiable in the point, and the fit in its data. Starting from blue noise, points slide along their
surface down that gradient (a move that leaves the surface or enters another body is taken back; shadow rays are traced anew
after each round), and each point has a weight that makes the ridge trust it more or less. The ridge itself moves along.

Compared at the same M, over seeds of the starting points, on lightings that neither the gradient nor the fit has seen:
relative error of the indirect light's coefficients in a basis of 64 functions, the ridge chosen on the lightings kept aside
for every row. All points are measured with one sample.

    python experiments/measurement_points.py [--scene cornell] [--points 16 64] [--seeds 3] [--rounds 16] [--data FOLDER]
"""

import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from _descent import descend
from _frames import arguments, bake, table
from jaxtyping import Array, Float

from data_gen.direct import direct_irradiance, visibility
from data_gen.sampling import measurement_points, random_points
from data_gen.scenarios import sample_lightings
from data_gen.tracer import Tracer
from prt_bench.dataset import Transport
from prt_bench.emitters import Emitters, irradiance
from prt_bench.lights import emitters
from prt_bench.linalg import leading_basis, relative_damping, ridge, rounding_floor
from prt_bench.methods.operator import coefficients, importance

BASIS, LIGHTINGS, KEPT, STEPS = 64, 1536, 1536, 5
RATE = 0.004
RIDGES = np.logspace(-6, -1, 11)
COLUMNS = ("points", "chosen by", "error, mean over seeds", "standard deviation", "against blue noise", "seconds")


class Lights(NamedTuple):
    """Lightings as emitters, and the coefficients [K, n] of the indirect light they cause, over their length."""

    lit: Emitters
    targets: Float[Array, "K n"]
    size: Float[Array, " n"]

    def part(self, rows: slice) -> "Lights":
        """Some of the lightings."""
        return Lights(jax.tree.map(lambda leaf: leaf[rows], self.lit), self.targets[:, rows], self.size[rows])


class Points(NamedTuple):
    """Where light is measured; weights and ridge as logarithms. None of them lies on hair."""

    position: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    ridge: float
    clearance: None = None


def measured(points: Points, moved: Array, weight: Array, lights: Lights, seen: Array) -> Float[Array, "M n"]:
    """Weighted irradiance at the points, moved along their tangent planes, over the size of the indirect light."""
    along = moved - points.normal * jnp.sum(moved * points.normal, axis=1, keepdims=True)
    lit = jax.vmap(lambda each, sees: irradiance(each, points.position + along, points.normal, sees)[:, 0])(
        lights.lit, seen
    )
    return (lit / lights.size[:, None]).T * jnp.exp(weight)[:, None]


def error(x: Array, targets: Array, kept_x: Array, kept: Array, factor: Array | float) -> Array:
    """Squared error on the lightings kept aside of a ridge fitted to the others; targets have length 1."""
    matrix = ridge(x, targets, relative_damping(x, factor))
    return jnp.mean(jnp.sum((matrix @ kept_x - kept) ** 2, axis=0))


def follow(tracer: Tracer, points: Points, fit: Lights, kept: Lights, rounds: int, free: tuple[bool, bool]) -> Points:
    """Points after some rounds down the gradient; `free` says whether places and weights move.

    A step moves a point by a part of the scene's extent, and a weight or the ridge by ten times that in its logarithm.
    """
    extent = tracer.reach / 4.0

    def moved(points: Points, step: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        place, weight, factor = step
        return place * extent * free[0], points.weight + 10.0 * weight * free[1], points.ridge + 10.0 * factor

    def loss(step: tuple[Array, Array, Array], given: tuple[Points, list[Array]]) -> Array:
        points, seen = given
        along, weight, factor = moved(points, step)
        x, y = (measured(points, along, weight, lights, sees) for lights, sees in zip((fit, kept), seen, strict=True))
        return jnp.log(error(x, fit.targets, y, kept.targets, jnp.exp(factor)))

    for _ in range(rounds):
        start = np.zeros(points.position.shape), np.zeros(len(points.weight)), np.zeros(())
        given = points, [_seen(tracer, points, lights) for lights in (fit, kept)]
        along, weight, factor = moved(points, descend(loss, start, STEPS, RATE, lambda _, given=given: given))
        along = np.asarray(along - points.normal * jnp.sum(along * points.normal, axis=1, keepdims=True))
        place = _on_surface(tracer, points.position, points.position + along, points.normal)
        points = Points(place, points.normal, np.asarray(weight), float(factor))
    return points


def _on_surface(tracer: Tracer, before: np.ndarray, after: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The moved points, but for those that no surface lies under or that lie in another body."""
    reach = 4.0 * tracer.offset
    above = (after + reach * normal).astype(np.float32)
    held = tracer.occluded(above, (-2.0 * reach * normal).astype(np.float32)) & ~tracer.inside(above)
    return np.where(held[:, None], after, before)


def _seen(tracer: Tracer, points: Points, lights: Lights) -> Array:
    return jnp.asarray(visibility(tracer, points, lights.lit))  # pyright: ignore[reportArgumentType]


def judged(tracer: Tracer, points: Points, fit: Lights, kept: Lights, test: Lights) -> float:
    """Relative error on `test`, fitted with the ridge that is best on the lightings kept aside."""
    still = jnp.zeros(points.position.shape)
    x, y, z = (
        measured(points, still, jnp.asarray(points.weight), each, _seen(tracer, points, each))
        for each in (fit, kept, test)
    )
    best = RIDGES[int(np.argmin([float(error(x, fit.targets, y, kept.targets, factor)) for factor in RIDGES]))]
    return float(jnp.sqrt(error(x, fit.targets, z, test.targets, best)))


def answers(transport: Transport, tracer: Tracer, basis: Array, count: int, seed: int) -> Lights:
    """Grey point lights, and the coefficients of what they cause in every channel."""
    lit = emitters(sample_lightings(transport.scene, "point", count, seed=seed, tracer=tracer, achromatic=True))
    albedo = jnp.asarray(transport.samples.albedo, jnp.float32)
    direct = direct_irradiance(tracer, transport.samples, lit)[..., 0]
    targets = coefficients(importance(transport, albedo, basis.astype(jnp.float32)), jnp.asarray(direct.T))
    joined = jnp.concatenate(list(targets))
    size = jnp.linalg.norm(joined, axis=0)
    return Lights(lit, joined / size, size)


def main() -> None:
    parser = arguments(__doc__, None, scene="cornell", points=[16, 64], seeds=3, rounds=16)
    settings = parser.parse_args()
    ds = bake(settings.scene, "point", settings.data, streamed=2048)
    tracer, light = Tracer(ds.scene), np.asarray(ds.split("train").indirect, float)
    columns = jnp.asarray(np.moveaxis(light, 1, 0).reshape(light.shape[1], -1))
    columns /= jnp.linalg.norm(columns, axis=0)
    basis, _ = leading_basis(columns, BASIS, rounding_floor(columns))
    known = answers(ds.transport, tracer, basis, LIGHTINGS + KEPT, seed=101)
    fit, kept = known.part(slice(0, LIGHTINGS)), known.part(slice(LIGHTINGS, None))
    test = answers(ds.transport, tracer, basis, KEPT, seed=202)
    lines = []
    for count in settings.points:
        errors: dict[str, list[float]] = {}
        seconds: dict[str, float] = {}
        for seed in range(settings.seeds):
            blue, _, _ = measurement_points(ds.scene, count, 1, seed, tracer)
            drawn = random_points(ds.scene, count, seed)
            start = Points(
                np.asarray(blue.position, float), np.asarray(blue.normal, float), np.zeros(count), np.log(1e-3)
            )
            ways = {
                "blue noise": lambda start=start: start,
                "uniformly random": lambda start=start, drawn=drawn: start._replace(
                    position=np.asarray(drawn.position, float), normal=np.asarray(drawn.normal, float)
                ),
                "gradient: weights": lambda start=start: follow(
                    tracer, start, fit, kept, settings.rounds, (False, True)
                ),
                "gradient: places": lambda start=start: follow(
                    tracer, start, fit, kept, settings.rounds, (True, False)
                ),
                "gradient: both": lambda start=start: follow(tracer, start, fit, kept, settings.rounds, (True, True)),
            }
            for way, choose in ways.items():
                started = time.perf_counter()
                points = choose()
                seconds[way] = time.perf_counter() - started
                errors.setdefault(way, []).append(judged(tracer, points, fit, kept, test))
        plain = np.array(errors["blue noise"])
        for way, found in errors.items():
            spread = np.std(found, ddof=1) if len(found) > 1 else 0.0
            lines.append([str(count), way, f"{np.mean(found):.4f}", f"{spread:.4f}", f"{np.mean(found / plain):.3f}",
                          f"{seconds[way]:.0f}"])  # fmt: skip
    table(COLUMNS, lines)


if __name__ == "__main__":
    main()
