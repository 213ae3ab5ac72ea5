"""The gather operator and its bounces: energy, convergence, fireflies and derivatives, on enclosures whose answer is known."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.rigs import room
from prt_bench.stability.routes import F32, F64, Route
from prt_bench.transport import GatherOperator, indirect, tail_bounds

_SAMPLES = 40


class Enclosure(NamedTuple):
    """Hits [S, R] of an enclosure (the entry S carries nothing), albedo [S, 1] and direct light [1, S, 1]."""

    hits: np.ndarray
    albedo: np.ndarray
    direct: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """G as a dense matrix in float64."""
        size = len(self.hits)
        found = np.zeros((size, size + 1))
        for row, entries in zip(found, self.hits, strict=True):
            np.add.at(row, entries, 1.0 / self.hits.shape[1])
        return found[:, :size]

    def solved(self) -> np.ndarray:
        """All bounces by a direct solve of E = G ρ (E_dir + E)."""
        step = self.matrix * self.albedo[:, 0]
        light = self.direct[0, :, 0].astype(np.float64)
        return np.linalg.solve(np.eye(len(step)) - step, step @ light)


def _enclosure(route: Route, albedo: float, rays: int, seed: int, escape: float = 0.0) -> Enclosure:
    rng = np.random.default_rng([seed, rays])
    hits = rng.integers(0, _SAMPLES, (_SAMPLES, rays))
    hits = np.where(rng.random(hits.shape) < escape, _SAMPLES, hits)
    reflect = np.full((_SAMPLES, 1), albedo) * rng.uniform(0.9, 1.0, (_SAMPLES, 1))
    return Enclosure(hits, route.arrive(reflect), route.arrive(rng.uniform(0.1, 1.0, (1, _SAMPLES, 1))))


def solvers() -> dict[str, Any]:
    """What bounces light until less than a tolerance is missing: the bound decides how often, as in the bake."""

    def bounced(enclosure: Enclosure, tolerance: float) -> tuple[jax.Array, float]:
        gather = GatherOperator.from_hits(enclosure.hits, len(enclosure.hits))
        albedo = jnp.asarray(enclosure.albedo)
        decay = np.clip(float(enclosure.albedo.max()), 1e-3, 0.995)
        bounds = tail_bounds(gather, albedo, int(np.log(tolerance * (1.0 - decay) / 10) / np.log(decay)) + 2)
        bounces = int(np.flatnonzero(bounds <= tolerance)[0]) + 1
        return indirect(gather, albedo, jnp.asarray(enclosure.direct), bounces)[0, :, 0], float(bounds[bounces - 1])

    return {"Neumann series": bounced}


def _enclosures(route: Route) -> Iterator[Member]:
    for albedo in (0.0, 0.5, 0.9, 0.99):
        for rays in (2, 64):
            for escape in (0.0, 0.3):
                yield Member(
                    f"albedo {albedo:g}, {rays} rays, {escape:.0%} escape", _enclosure(route, albedo, rays, 0, escape)
                )


_TOLERANCE = 1e-4


@case("F1", "all bounces against a direct solve", subjects=solvers, family=_enclosures)
def bounces(solver: Any, enclosure: Enclosure, route: Route) -> Iterator[Measured]:
    """F1: at albedo 0.99 a fixed 64 bounces lose half of the energy; the bound of the tail keeps what it promises."""
    found, bound = solver(enclosure, _TOLERANCE)
    wanted = enclosure.solved()
    gap = float(np.abs(np.asarray(found, np.float64) - wanted).max())
    brightest = float(enclosure.direct.max())
    amplification = 1.0 / (1.0 - float(enclosure.albedo.max()))
    unit = route.eps * amplification * brightest
    yield Measured(gap, bound * brightest + 30 * unit)


@case("F1", "energy is kept", subjects=solvers, family=_enclosures)
def energy(solver: Any, enclosure: Enclosure, route: Route) -> Iterator[Measured]:
    """F1: nothing exceeds the geometric series of the largest albedo, and nothing is negative."""
    found, _ = solver(enclosure, _TOLERANCE)
    albedo, brightest = float(enclosure.albedo.max()), float(enclosure.direct.max())
    limit = albedo / (1.0 - albedo) * brightest
    yield Measured(float(np.asarray(found).max()), limit * (1 + 30 * route.eps / (1.0 - albedo)))
    yield Measured(max(-float(np.asarray(found).min()), 0.0), 0.0)


def _closed(route: Route) -> Iterator[Member]:
    for seed in range(3):
        enclosure = _enclosure(route, 1.0, 16, seed)
        yield Member(f"seed {seed}", enclosure._replace(albedo=np.ones_like(enclosure.albedo)))


@case("F1", "closed box of albedo 1", kind=Kind.REFUSAL, subjects=solvers, family=_closed)
def no_decay(solver: Any, enclosure: Enclosure, route: Route) -> bool:
    """F1: the series diverges, and the bound refuses."""
    solver(enclosure, _TOLERANCE)
    return False


def gathers() -> dict[str, Any]:
    """The operator, without and with the table for fast gradients."""

    def of(differentiable: bool) -> Any:
        return lambda hits: GatherOperator.from_hits(hits, len(hits), differentiable)

    return {"gather": of(False), "gather with adjoint": of(True)}


def _tables(route: Route) -> Iterator[Member]:
    for rays in (1, 2, 16, 64):
        for escape in (0.0, 0.3, 1.0):
            yield Member(f"{rays} rays, {escape:.0%} escape", _enclosure(route, 1.0, rays, 1, escape))


@case("F2", "rows sum to at most one", subjects=gathers, family=_tables)
def rows(made: Any, enclosure: Enclosure, route: Route) -> Iterator[Measured]:
    """F2: a constant field is gathered as the share of rays that hit, for any number of rays."""
    gather = made(enclosure.hits)
    found = np.asarray(gather(jnp.ones((_SAMPLES, 1), route.compute)), np.float64)[:, 0]
    share = np.mean(enclosure.hits < _SAMPLES, axis=1)
    yield Measured(float(np.abs(found - share).max()), 30 * route.eps, route.eps)
    yield Measured(float(max(found.max() - 1.0, 0.0)), 4 * route.eps)


@case("B7", "one firefly texel", subjects=gathers, family=_tables)
def firefly(made: Any, enclosure: Enclosure, route: Route) -> Iterator[Measured]:
    """B7: indirect light stays under the row sum times the brightest light, and the rest of the light is not drowned."""
    light = enclosure.direct[0].copy()
    light[3] = 2.0**18
    gather = made(enclosure.hits)
    found = np.asarray(gather(jnp.asarray(light)), np.float64)[:, 0]
    wanted = enclosure.matrix @ light[:, 0].astype(np.float64)
    yield Measured(float(np.max(np.abs(found - wanted) / np.maximum(wanted, 1e-30))), 30 * route.eps, route.eps)
    yield Measured(float(found.max()), float(enclosure.matrix.sum(axis=1).max() * light.max()) * (1 + 4 * route.eps))


@case(
    "F2", "reciprocity of the room's walls", subjects=gathers, routes=(F64, F32),
    family=lambda route: [Member("cube", np.asarray(room().transport.sample_hits))],
)  # fmt: skip
def reciprocity(made: Any, hits: np.ndarray, route: Route) -> Iterator[Measured]:
    """F2: between equal areas, form factors are symmetric; the cube's are 0.1998 to the wall opposite and 0.2 to others.

    Bounds are four standard deviations of that many independent rays.
    """
    side = len(hits) // 6
    wall = jnp.asarray(np.kron(np.eye(6), np.ones((side, 1))), route.compute)
    factors = np.asarray(made(hits)(wall), np.float64).reshape(6, side, 6).mean(axis=1)
    noise = 4 * np.sqrt(0.2 * 0.8 / (side * hits.shape[1]))
    yield Measured(float(np.abs(factors - factors.T).max()), np.sqrt(2) * noise)
    yield Measured(float(np.abs(factors + 0.2 * np.eye(6) - 0.2).max()), noise + 2e-4)
    yield Measured(float(np.abs(np.diagonal(factors)).max()), 0.0)


def _dark_and_bright(route: Route) -> Iterator[Member]:
    for name, albedo, escape in (("black", 0.0, 0.0), ("grey", 0.5, 0.0), ("bright", 0.9, 0.2)):
        enclosure = _enclosure(route, albedo, 16, 2, escape)
        yield Member(name, enclosure)
        yield Member(f"{name}, no light", enclosure._replace(direct=0 * enclosure.direct))
        yield Member(f"{name}, equal", enclosure._replace(albedo=np.full_like(enclosure.albedo, max(albedo, 0.1))))


@case("F1", "bounces in albedo and light", kind=Kind.GRADIENT, subjects=gathers, family=_dark_and_bright)
def bounce_gradient(made: Any, enclosure: Enclosure, route: Route) -> Iterator[Measured]:
    """F1: through twelve bounces, for black walls, no light and equal walls too."""
    gather = made(enclosure.hits)
    rng = np.random.default_rng(0)
    arguments = (enclosure.albedo, enclosure.direct)
    directions = [rng.normal(size=argument.shape) for argument in arguments]
    return gradient_error(lambda albedo, direct: indirect(gather, albedo, direct, 12), arguments, directions, route)
