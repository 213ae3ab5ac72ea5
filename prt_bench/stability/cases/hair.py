"""Hair: longitudinal lobes of any width and their slopes, white fibres, one strand, strands without length, size, contact."""

from collections.abc import Callable, Iterator
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from data_gen import hair_paths
from data_gen.hair_paths import Fate
from data_gen.medium_walk import walk_keys
from data_gen.resolve import HitResolver
from data_gen.strand_atlas import points_with_strands, unwrap_with_strands
from data_gen.strands import with_strands
from data_gen.tracer import Tracer
from prt_bench import emitters as lights
from prt_bench import hair as fibres
from prt_bench.hair import Hair, Inclination
from prt_bench.lights import PointLight
from prt_bench.medium import GREATEST_IOR
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.routes import F32, F64, Route
from prt_bench.strands import TEXELS, Strands

_VARIANCES = (1e-6, 1e-4, 1e-2, 0.1, 1.0, 10.0)
_LEAVING = (-1.2, 0.0, 0.7, 1.5)
_WIDTH = 10.0  # standard deviations of a lobe that are looked at
_DEVIATIONS = 5.0
_WHITE = (0.0, 0.0, 0.0)


def scattering() -> dict[str, ModuleType]:
    """The module, whose functions are looked up when they are called."""
    return {"fibre": fibres}


class Lobe(NamedTuple):
    """A variance and, around the middle of a lobe, sines and cosines of inclinations as they arrived; `weight` cosθ_i dθ_i."""

    variance: np.ndarray
    into: Inclination
    out: Inclination
    weight: np.ndarray


def _lobe(route: Route, variance: float, leaving: float, count: int) -> Lobe:
    node, weight = np.polynomial.legendre.leggauss(count)
    reach = _WIDTH * np.sqrt(variance)
    low, high = max(-leaving - reach, -0.5 * np.pi), min(-leaving + reach, 0.5 * np.pi)
    angle = 0.5 * (low + high) + 0.5 * (high - low) * node
    into, out = (
        Inclination(route.arrive(np.sin(part)), route.arrive(np.cos(part))) for part in (angle, np.full(count, leaving))
    )
    return Lobe(route.arrive(variance), into, out, 0.5 * (high - low) * weight * np.cos(angle))


def _lobes(count: int) -> Callable[[Route], Iterator[Member]]:
    return lambda route: (
        Member(f"variance {variance:g}, leaving at {leaving:g}", _lobe(route, variance, leaving, count))
        for variance in _VARIANCES
        for leaving in _LEAVING
    )


def _by_azimuth(lobe: Lobe) -> np.ndarray:
    """M without a Bessel function: a distribution on the sphere, exp((cos γ − 1) / v) normalised, averaged over azimuth."""
    v = float(lobe.variance)
    into, out = (np.arctan2(*(np.asarray(part, np.float64) for part in angle)) for angle in (lobe.into, lobe.out))
    both = np.cos(into) * np.cos(out)
    reach = np.minimum(np.pi, 16.0 * np.sqrt(v / np.maximum(both, 1e-12)))
    # The trapezoidal rule: the integrand is even about 0 and about the end, or nothing there.
    weight = np.r_[0.5, np.ones(159), 0.5] / 160.0
    azimuth = reach[:, None] * np.linspace(0.0, 1.0, 161)
    drop = 2.0 * (np.sin(0.5 * (into + out)) ** 2)[:, None] + 2.0 * both[:, None] * np.sin(0.5 * azimuth) ** 2
    return (np.exp(-drop / v) @ weight) * reach / np.pi / (v * -np.expm1(-2.0 / v))


@case("F4", "longitudinal lobes of any width", subjects=scattering, family=_lobes(200), routes=(F64, F32))
def lobe_values(tested: Any, lobe: Lobe, route: Route) -> Iterator[Measured]:
    """F4: the printed form is NaN below a variance of 0.1 in float32. M is that of `_by_azimuth`, and integrates to 1.

    Rounding moves inclinations by eps, which a narrow lobe sees as eps over its width.
    """
    v, expected = float(lobe.variance), _by_azimuth(lobe)
    chord = (lobe.into.sine + lobe.out.sine) ** 2 + (lobe.into.cosine - lobe.out.cosine) ** 2
    spread = 1.0 + (np.sqrt(chord.astype(np.float64)) + chord) / v
    for arrays in (np.asarray, jnp.asarray):
        into, out = (Inclination(*map(arrays, part)) for part in (lobe.into, lobe.out))
        found = np.asarray(tested.longitudinal(into, out, arrays(lobe.variance)), np.float64)
        off = float(np.max(np.abs(found / expected - 1.0) / spread))
        yield Measured(off, 30 * route.eps, route.eps)
        yield Measured(abs(float(found @ lobe.weight) - 1.0), 30 * route.eps / np.sqrt(min(v, 1.0)))


@case(
    "F4",
    "longitudinal lobes of any width",
    kind=Kind.GRADIENT,
    subjects=scattering,
    family=_lobes(24),
    routes=(F64, F32),
)
def lobe_gradients(tested: Any, lobe: Lobe, route: Route) -> Iterator[Measured]:
    """F4: slopes in the variance and in both inclinations; that of exp(−x) I₀(x), as printed, cancels where x is large."""
    arguments = [np.asarray(lobe.variance), *(np.stack(angle) for angle in (lobe.into, lobe.out))]
    rng, width = np.random.default_rng(0), np.sqrt(min(float(lobe.variance), 1.0))
    turns = [width * rng.normal(size=each.shape) for each in arguments[1:]]
    return gradient_error(partial(_along, tested.longitudinal), arguments, [np.asarray(lobe.variance), *turns], route)


@partial(jax.jit, static_argnums=0)
def _along(longitudinal: Any, variance: Any, into: Any, out: Any) -> Any:
    return longitudinal(Inclination(*into), Inclination(*out), variance)


def _whites(route: Route) -> Iterator[Member]:
    for ior in (1.0, 1.3, 1.55, GREATEST_IOR):
        for variance, scale in ((1e-7, 1e-4), (0.05, 0.2), (10.0, 10.0)):
            yield Member(f"index {ior:g}, variance {variance:g}", Hair(_WHITE, variance, scale, ior))


@case("F4", "white fibres keep all light", subjects=scattering, family=_whites, routes=(F64,))
def white(tested: Any, hair: Hair, route: Route) -> Iterator[Measured]:
    """F4: lobes without one of their Fresnel terms, or without the light that goes round more often, lose or make energy.

    Along the fibre, too: what leaves at any inclination adds up to 1, and directions that are drawn are those of the light.
    """
    sine = np.sin(np.linspace(-1.5, 1.5, 31))
    kept = tested.albedo_at(hair, Inclination.of(sine))
    yield Measured(float(np.abs(kept - 1.0).max()), 1e3 * route.eps)
    count = 2000
    rng = np.random.default_rng(0)
    out = Inclination.of(rng.uniform(-1.0, 1.0, count))
    found = tested.crossing(hair, out, rng.uniform(-1.0, 1.0, count))
    yield Measured(float(max(-found.weights.min(), found.weights.max() - 1.0, 0.0)), 30 * route.eps)
    drawn = tested.draw(hair, out, found, np.arange(count) % fibres.LOBES, rng.uniform(size=(3, count)))
    yield Measured(float(np.maximum(np.abs(drawn.sine).max() - 1.0, 0.0)), 0.0)
    yield Measured(float(np.sum(~np.isfinite(drawn.azimuth))), 0.0)


class Tuft(NamedTuple):
    """Strands in a ball of radius 0.5 m times `scale`, 0.6 m long and 3 cm thick times that."""

    hair: Hair
    strands: int = 60
    scale: float = 1.0

    def scene(self) -> Scene:
        """The strands alone."""
        rng = np.random.default_rng(0)
        direction = rng.normal(size=(self.strands, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        middle = rng.uniform(-0.3, 0.3, (self.strands, 3))
        nodes = self.scale * (middle[:, None] + np.array([-0.3, 0.0, 0.3])[:, None] * direction[:, None]).reshape(-1, 3)
        strands = Strands(
            nodes,
            3 * np.arange(self.strands + 1),
            np.full(self.strands, 0.015 * self.scale),
            np.zeros(self.strands, int),
        )
        mesh = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0, int))
        bare = Scene("tuft", mesh, (Material("hair", hair=self.hair),), Camera((0, 0, 3 * self.scale), (0, 0, 0)))
        return with_strands(bare, strands)


def _followed(tested: Any, tuft: Tuft, paths: int) -> np.ndarray:
    """What became of paths from all texels of a tuft [n, 3]."""
    scene = tuft.scene()
    lightmap = unwrap_with_strands(scene, 64)
    points = points_with_strands(scene, lightmap)
    resolver = HitResolver.create(scene.mesh, lightmap, points)
    assert scene.strands is not None
    texel = np.arange(tuft.strands * TEXELS)
    walker = tested.StrandPaths(scene, scene.strands, Tracer(scene, 1), resolver, 3)
    return walker.follow(np.repeat(texel, paths), walk_keys(texel, paths, 0).ravel()).fate


def paths() -> dict[str, ModuleType]:
    """The module that follows paths among fibres."""
    return {"paths": hair_paths}


def _tufts(route: Route) -> Iterator[Member]:
    brown = Hair((0.1, 0.25, 0.6))
    yield Member("white", Tuft(Hair(_WHITE, ior=GREATEST_IOR)))
    yield Member("narrow and white", Tuft(Hair(_WHITE, 1e-7, 1e-4)))
    yield Member("one strand", Tuft(brown, strands=1))
    yield Member("black", Tuft(Hair((1e6, 1e6, 1e6))))
    for scale in (1e-3, 1e4):
        yield Member(f"scale {scale:g}", Tuft(brown, scale=scale))


@case("F4", "paths among fibres end, and none is lost", subjects=paths, family=_tufts, routes=(F32,))
def energy(tested: Any, tuft: Tuft, route: Route) -> Iterator[Measured]:
    """F4, G3: white fibres absorb nothing, a strand alone loses 1 less its albedo, and size alone changes nothing."""
    count = max(6000 // (tuft.strands * TEXELS), 1)
    fate = _followed(tested, tuft, count)
    yield Measured(float(np.mean((fate == Fate.LOST) | (fate == Fate.ALIVE))), 1e-3)
    escaped = np.mean(fate == Fate.ESCAPED, axis=0)
    if tuft.hair.absorption == _WHITE:
        yield Measured(float(1.0 - escaped.min()), 1e-3)
    if tuft.strands == 1:
        deviation = 0.5 / np.sqrt(len(fate))
        yield Measured(float(np.abs(escaped - tuft.hair.albedo).max()), _DEVIATIONS * deviation)
    if tuft.scale != 1.0:
        plain = _followed(tested, tuft._replace(scale=1.0), count)
        yield Measured(float(np.mean(fate != plain)), 0.03)


def _damaged(route: Route) -> Iterator[Member]:
    nodes = np.array([(0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.2, 0.0)])
    radius, starts = np.array([1e-3]), np.array([0, 3])
    yield Member("without length", (nodes * 0.0, starts, radius))
    yield Member("a segment without length", (nodes[[0, 1, 1]], starts, radius))
    yield Member("one node", (nodes, np.array([0, 1, 3]), np.repeat(radius, 2)))
    yield Member("a node that is not finite", (nodes * np.array([1.0, np.nan, 1.0]), starts, radius))
    yield Member("no radius", (nodes, starts, 0.0 * radius))
    yield Member("no strands", (nodes[:0], starts[:1], radius[:0]))


@case(
    "F4", "strands without length or width", kind=Kind.REFUSAL, subjects=lambda: {"strands": Strands}, family=_damaged,
    routes=(F64,),
)  # fmt: skip
def refused(made: Any, parts: tuple[np.ndarray, ...], route: Route) -> bool:
    """F4: a strand without length has no direction; tangents of it are 0 / 0."""
    made(*parts, np.zeros(len(parts[1]) - 1, int))
    return False


def _near_fibres(route: Route) -> Iterator[Member]:
    for height in (0.0, 1e-30, 1e-6, 1e-3):
        for along in (0.0, 1.0):
            yield Member(f"{height:g} above, {along:g} along", np.array([along * height, height, 0.0]))


@partial(jax.jit, static_argnums=0)
def _on_fibre(strength: Any, place: Any) -> Any:
    """Irradiance of a fibre along x at the origin, from a point light of radius 1 cm."""
    light = PointLight(place, (1.0, 1.0, 1.0), 0.01).emitters()
    cast = jax.tree.map(lambda part: part.astype(place.dtype), light)
    axis = jnp.eye(3, dtype=place.dtype)[:1]
    return strength(cast, 0.0 * axis, axis, jnp.ones(1, bool))


def strengths() -> dict[str, ModuleType]:
    """The module that says how strong emitters are where."""
    return {"emitters": lights}


@case("G4", "a light on a fibre", subjects=strengths, family=_near_fibres, routes=(F64, F32))
def contact(tested: Any, place: np.ndarray, route: Route) -> Iterator[Measured]:
    """G4: bounded by the light's radius, 1 / (π r_s²), and above zero in every direction but along the fibre."""
    found = _on_fibre(tested.strength, jnp.asarray(place, route.compute))
    yield Measured(float(found[0, 0]), (1.0 + 30 * route.eps) * 1e4 / np.pi)
    height = float(np.hypot(place[0], place[1]))
    if height >= 1e-6:
        expected = place[1] / height / np.pi / (height**2 + 1e-4)
        yield Measured(abs(float(found[0, 0]) / expected - 1.0), 30 * route.eps, route.eps)


@case("G4", "a light on a fibre", kind=Kind.GRADIENT, subjects=strengths, family=_near_fibres, routes=(F64, F32))
def contact_gradient(tested: Any, place: np.ndarray, route: Route) -> Iterator[Measured]:
    """G4: a mean around the fibre has a finite slope where light and fibre touch, and along the fibre; elsewhere its own."""

    def lit(place: Any) -> Any:
        return _on_fibre(tested.strength, place)

    for where in (place, np.array([place[1], 0.0, 0.0])):
        slope = jax.jacobian(lit)(jnp.asarray(where, route.compute))
        yield Measured(0.0 if np.all(np.isfinite(slope)) else np.nan, 1.0)
    if place[1] >= 1e-6:
        turn = np.random.default_rng(0).normal(size=3) * place[1]
        yield from gradient_error(lit, [place], [turn], route)
