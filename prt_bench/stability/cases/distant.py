"""Transfer of distant light: what ships, and what scales with the light. The harmonics themselves are in `spherical`."""

from collections.abc import Iterator
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.emitters import irradiance
from prt_bench.harmonic import HarmonicModel
from prt_bench.lights import DirectionalLight, Lighting, emitters
from prt_bench.methods.base import Method
from prt_bench.methods.neural_transfer import NeuralTransfer
from prt_bench.models import Model
from prt_bench.stability.cases.fits import EQUAL, difference, shipped
from prt_bench.stability.cell import Measured, Member, case
from prt_bench.stability.rigs import OPEN, room, unlearned
from prt_bench.stability.routes import F32, F64, Route


def _suns(route: Route) -> Iterator[Member]:
    """From straight in front, along a wall, and from behind, where the room is dark."""
    for name, direction in {"front": (0, 0, -1), "grazing": (1, 0, -1e-3), "behind": (0, 0, 1)}.items():
        for strength in (1e-5, 1.0, 1e5):
            yield Member(f"{name}, {strength:g}", Lighting([DirectionalLight(direction, (strength, strength, 0.0))]))


def _fitted(method: Method) -> Model:
    """Fitted to the open room; what is trained, once for all lights, since it sees none and takes seconds."""
    return _trained(method) if isinstance(method, NeuralTransfer) else method.fit(room(OPEN).split("train"))


@cache
def _trained(method: NeuralTransfer) -> Model:
    return method.fit(room(OPEN).split("train"))


class _Lit:
    """What a model may observe of distant light: itself, or what it gives the room's measurement points, which it reaches."""

    def __init__(self, lighting: Lighting) -> None:
        self.lightings = (lighting,)
        points, light = room(OPEN).measurement_points, jax.tree.map(lambda leaf: leaf[0], emitters([lighting]))
        self.measured = np.asarray(irradiance(light, jnp.asarray(points.position), jnp.asarray(points.normal)))[None]


@case("A13", "transfer vectors shipped in float32", subjects=unlearned, family=_suns, routes=(F64, F32))
def ships(method: Method, sun: Lighting, route: Route) -> Iterator[Measured]:
    """Finite, and the asset differs by float32 rounding of the terms that it adds up."""
    model = _fitted(method)
    lit = _Lit(sun)
    plain = np.asarray(model.predict(lit), np.float64)  # pyright: ignore[reportArgumentType]
    yield Measured(0.0 if np.all(np.isfinite(plain)) else np.nan, 1.0)
    found, size = shipped(model, lit)
    if isinstance(model, HarmonicModel):
        terms = jnp.abs(model.basis).max(axis=(0, 1)) @ jnp.abs(model.measure(lit))[0]  # pyright: ignore[reportArgumentType]
        size = float(terms.max())
    unit = F32.eps * size
    yield Measured(float(np.abs(found - plain).max()), 8 * unit, unit)


@case("C4", "distant light, f(a x) = a f(x)", subjects=unlearned, family=_suns, routes=(F64, F32))
def homogeneous(method: Method, sun: Lighting, route: Route) -> Iterator[Measured]:
    """C4, A6: homogeneous and additive over twelve decades, and exactly black for no light."""
    model = _fitted(method)
    x = jnp.asarray(model.measure(_Lit(sun)), jnp.float64)  # pyright: ignore[reportArgumentType]
    plain = model.reconstruct(model.transfer(x))
    for factor in (1e-6, 3.0, 1e6):
        yield Measured(difference(model.reconstruct(model.transfer(factor * x)) / factor, plain), EQUAL)
    other = x[:, ::-1]
    together = model.reconstruct(model.transfer(x + other))
    apart = plain + model.reconstruct(model.transfer(other))
    yield Measured(difference(together, apart), EQUAL)
    yield Measured(float(np.abs(model.reconstruct(model.transfer(0.0 * x))).max()), 0.0)
