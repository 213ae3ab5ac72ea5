"""Lights: irradiance at contact, at any scale and in every dtype, derivatives in all parameters, refusal of the unphysical."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.emitters import irradiance
from prt_bench.environment import EnvironmentMap, median_cut
from prt_bench.errors import LightError
from prt_bench.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    Lighting,
    PointLight,
    RectLight,
    SphereLight,
    SpotLight,
)
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.differences import gradient_error
from prt_bench.stability.routes import F32, F64, Route

_RED = np.array([3.0, 2.0, 1.0])


class Lit(NamedTuple):
    """Points and normals as they arrived, and how far the light is from where it usually stands, in metres."""

    position: np.ndarray
    normal: np.ndarray
    offset: np.ndarray


def _made(kind: type[Light], offset: Any = (0.0, 0.0, 0.0), scale: Any = 1.0) -> Light:
    """A light above the origin, moved by `offset`; a scene `scale` times as large with the irradiance unchanged."""
    place = scale * (jnp.array([0.1, 1.2, -0.2]) + jnp.asarray(offset))
    bright = scale**2 * _RED
    return {
        PointLight: lambda: PointLight(place, bright, 0.01 * scale),
        SpotLight: lambda: SpotLight(place, [0.1, -1.0, 0.1], bright, 0.8, 0.4, 0.01 * scale),
        DirectionalLight: lambda: DirectionalLight([0.2, -1.0, 0.3], _RED),
        SphereLight: lambda: SphereLight(place, 0.2 * scale, _RED),
        RectLight: lambda: RectLight(place, scale * jnp.array([0.3, 0, 0]), scale * jnp.array([0, 0, 0.4]), _RED),
        EnvironmentLight: lambda: EnvironmentLight(np.random.default_rng(0).random((8, 16, 3)) ** 4, offset),
    }[kind]()


def kinds() -> dict[str, type[Light]]:
    """Every type of light."""
    return {kind.__name__: kind for kind in Light.__subclasses__()}


def _irradiance(light: Light, position: Any, normal: Any, route: Route) -> jax.Array:
    """Irradiance computed in the route's dtype, as the bake does."""
    emitters = jax.tree.map(lambda leaf: leaf.astype(route.compute), light.emitters())
    return irradiance(emitters, jnp.asarray(position, route.compute), jnp.asarray(normal, route.compute))


def _floor(route: Route, offsets: dict[str, tuple[float, float, float]]) -> Iterator[Member]:
    rng = np.random.default_rng(0)
    ground = np.concatenate([np.zeros((1, 3)), rng.uniform(-0.5, 0.5, (7, 3)) * [1, 0, 1]])
    up = np.tile([0.0, 1.0, 0.0], (8, 1))
    for name, offset in offsets.items():
        yield Member(name, Lit(route.arrive(ground), route.arrive(up), np.array(offset)))


def _contacts(route: Route) -> Iterator[Member]:
    at_origin = (-0.1, -1.2, 0.2)
    return _floor(
        route,
        {f"{height:g} above": (at_origin[0], at_origin[1] + height, at_origin[2]) for height in (0, 1e-30, 1e-6, 1e-3)},
    )


@case("G4", "light on a surface", subjects=kinds, family=_contacts)
def contact(kind: type[Light], lit: Lit, route: Route) -> Iterator[Measured]:
    """G4: bounded by the light's radius, 1 / r_s², instead of 1e12."""
    light = _made(kind, lit.offset)
    bound = max(float(_RED.max()) / 0.01**2, 4 * np.pi * float(_RED.max()) * 1e2)
    yield Measured(float(jnp.abs(_irradiance(light, lit.position, lit.normal, route)).max()), bound)


@case("G4", "light on a surface", kind=Kind.GRADIENT, subjects=kinds, family=_contacts)
def contact_gradient(kind: type[Light], lit: Lit, route: Route) -> Iterator[Measured]:
    """G4: finite in every parameter where a point and a light touch."""
    leaves, tree = jax.tree.flatten(_made(kind, lit.offset))

    def total(leaves: list) -> jax.Array:
        return jnp.sum(_irradiance(jax.tree.unflatten(tree, leaves), lit.position, lit.normal, route))

    slopes = jax.grad(total)([jnp.asarray(leaf, route.compute) for leaf in leaves])
    yield Measured(0.0 if all(bool(jnp.all(jnp.isfinite(slope))) for slope in slopes) else np.nan, 1.0)


def _above(route: Route) -> Iterator[Member]:
    return _floor(route, {"as usual": (0.0, 0.0, 0.0), "low": (0.0, -1.0, 0.1), "aside": (0.4, -0.3, -0.2)})


@case("C5", "irradiance in every light parameter", kind=Kind.GRADIENT, subjects=kinds, family=_above)
def parameters(kind: type[Light], lit: Lit, route: Route) -> Iterator[Measured]:
    """C5: position, direction, colour, cone, radius, extent and rotation, each against differences."""
    leaves, tree = jax.tree.flatten(_made(kind, lit.offset))
    rng = np.random.default_rng(1)

    def lit_by(*leaves: jax.Array) -> jax.Array:
        return irradiance(
            jax.tree.map(lambda leaf: leaf.astype(leaves[0].dtype), jax.tree.unflatten(tree, leaves).emitters()),
            jnp.asarray(lit.position, leaves[0].dtype), jnp.asarray(lit.normal, leaves[0].dtype),
        )  # fmt: skip

    arguments = [np.asarray(leaf, np.float64) for leaf in leaves]
    return gradient_error(lit_by, arguments, [rng.normal(size=a.shape) * (np.abs(a) + 0.1) for a in arguments], route)


@case("G3", "scenes of any size", subjects=kinds, family=_above)
def any_scale(kind: type[Light], lit: Lit, route: Route) -> Iterator[Measured]:
    """G3, G4: a scene 2ᵏ times as large, with intensities that grow by its square, has the same irradiance."""
    plain = np.asarray(_irradiance(_made(kind, lit.offset), lit.position, lit.normal, route), np.float64)
    for scale in (2.0**-10, 2.0**14):
        light = _made(kind, lit.offset, scale)
        found = np.asarray(_irradiance(light, scale * lit.position, lit.normal, route), np.float64)
        yield Measured(float(np.abs(found - plain).max() / plain.max()), 30 * route.eps, route.eps)


@case("C4", "irradiance adds up and is never negative", subjects=kinds, family=_above)
def superposition(kind: type[Light], lit: Lit, route: Route) -> Iterator[Measured]:
    """A light and twice that light give three times the irradiance."""
    light = _made(kind, lit.offset).emitters()
    doubled = Lighting([_made(kind, lit.offset)]).lights[0].emitters()
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]).astype(route.compute), light, doubled)
    brighter = jnp.where(jnp.arange(len(both.intensity)) < len(light.intensity), 1.0, 2.0)[:, None].astype(
        route.compute
    )
    together = type(both)(both.position, both.axis, both.intensity * brighter, both.profile)
    place = jnp.asarray(lit.position), jnp.asarray(lit.normal)
    alone = np.asarray(_irradiance(_made(kind, lit.offset), *place, route), np.float64)
    found = np.asarray(irradiance(together, *place), np.float64)
    yield Measured(float(np.abs(found - 3 * alone).max() / alone.max()), 30 * route.eps, route.eps)
    yield Measured(float(max(-found.min(), 0.0)), 0.0)


def _damaged() -> dict[str, Any]:
    """One unphysical light per way in which a parameter can be wrong, made when asked for."""
    return {
        "negative intensity": lambda: Lighting([PointLight([0, 0, 0], [-1.0, 0, 0])]).check(),
        "NaN position": lambda: Lighting([PointLight([np.nan, 0, 0], [1.0, 1, 1])]).check(),
        "infinite intensity": lambda: Lighting([PointLight([0, 0, 0], [np.inf, 1, 1])]).check(),
        "zero direction": lambda: Lighting([DirectionalLight([0, 0, 0], [1.0, 1, 1])]).check(),
        "zero spot direction": lambda: Lighting([SpotLight([0, 0, 0], [0, 0, 0], [1.0, 1, 1])]).check(),
        "cone beyond the sphere": lambda: Lighting([SpotLight([0, 0, 0], [0, 1, 0], [1.0, 1, 1], 4.0)]).check(),
        "sphere of no size": lambda: Lighting([SphereLight([0, 0, 0], 0.0, [1.0, 1, 1])]).check(),
        "rectangle of no area": lambda: Lighting([RectLight([0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [1, 1, 1])]).check(),
        "negative sky": lambda: EnvironmentMap("sky", np.full((4, 8, 3), -1.0)),
        "NaN sky": lambda: EnvironmentMap("sky", np.full((4, 8, 3), np.nan)),
    }


@case(
    "C5", "unphysical lights", kind=Kind.REFUSAL, subjects=lambda: {"check": lambda make: make()}, routes=(F64,),
    family=lambda route: (Member(name, make) for name, make in _damaged().items()),
)  # fmt: skip
def unphysical(check: Any, make: Any, route: Route) -> bool:
    """Each is refused with the name of the parameter."""
    check(make)
    return False


def _bad_maps(route: Route) -> Iterator[Member]:
    """Maps with some bad values among good ones, and how many."""
    good = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    for name, values in {
        "one NaN": [np.nan],
        "one negative": [-0.5],
        "one infinite": [np.inf],
        "some of each": [np.nan, -1e-3, np.inf, -np.inf],
        "all NaN": [np.nan] * good.size,
        "none": [],
    }.items():
        sky = good.copy()
        sky.flat[: len(values)] = values
        yield Member(name, (sky, len(values)))


@case("C5", "environment maps with bad pixels", subjects=lambda: {"repaired": EnvironmentMap.repaired}, family=_bad_maps,
      routes=(F64,))  # fmt: skip
def bad_pixels(repaired: Any, map_: tuple[np.ndarray, int], route: Route) -> Iterator[Measured]:
    """C5: refused with their count unless repaired, and then counted too; good values stay, and light is finite."""
    sky, count = map_
    made, found = repaired("sky", sky)
    yield Measured(abs(found - count), 0.0)
    yield Measured(float(np.sum(made.radiance.ravel()[count:] != sky.ravel()[count:])), 0.0)
    refused = ""
    try:
        EnvironmentMap("sky", sky)
    except LightError as error:
        refused = str(error)
    yield Measured(float((f"{count} negative or non-finite" in refused) != (count > 0)), 0.0)
    _, energy = median_cut(made, 8)
    yield Measured(0.0 if np.all(np.isfinite(energy)) and np.all(energy >= 0) else np.nan, 1.0)
    yield Measured(float(np.max(made.radiance) > np.max(sky, where=np.isfinite(sky), initial=0.0)), 0.0)


def _skies(route: Route) -> Iterator[Member]:
    rng = np.random.default_rng(0)
    sun = np.full((16, 32, 3), 0.1)
    sun[4, 20] = 6e4
    for name, sky in {
        "black": np.zeros((8, 16, 3)), "one texel": np.ones((1, 1, 3)), "sun": sun, "flat": np.ones((16, 32, 3)),
        "one row": rng.random((1, 64, 1)) * np.ones(3), "twelve decades": 10.0 ** rng.uniform(-6, 4, (16, 32, 1)) * np.ones(3),
    }.items():  # fmt: skip
        yield Member(name, route.arrive(sky))


@case(
    "A7",
    "environment maps by median cut",
    subjects=lambda: {"median_cut": median_cut},
    family=_skies,
    routes=(F64, F32),
)
def skies(cut: Any, sky: np.ndarray, route: Route) -> Iterator[Measured]:
    """Directions stay unit vectors, and the vector irradiance of the whole sky is kept, from one texel to a sun."""
    from prt_bench.environment import texel_directions

    direction, energy = cut(EnvironmentMap(f"{sky.shape}{sky.sum()}", sky.astype(np.float32)), 64)
    every, solid = texel_directions(*sky.shape[:2])
    wanted = np.einsum(
        "hwd,hwc,hw->dc", every, sky.astype(np.float32), np.broadcast_to(solid, sky.shape[:2]), dtype=float
    )
    size = float(np.sum(sky.astype(float) * solid[..., None])) or 1.0
    yield Measured(float(np.abs(direction.T @ energy - wanted).max() / size), 1e-6)
    yield Measured(float(np.abs(np.linalg.norm(direction, axis=1) - 1).max()), 1e-12)
