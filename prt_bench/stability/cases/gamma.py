"""Gamma space: light of either sign goes there and back, and its slope at black is finite."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import jax
import numpy as np

from prt_bench import gamma as library
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.routes import F32, F64, Route

_BOTH = (F64, F32)
_SIZES = np.geomspace(1e-12, 1e4, 200)  # relative to the root mean square of the light
_LIGHT = np.concatenate([-_SIZES, [0.0], _SIZES])


def curves() -> dict[str, ModuleType]:
    """The module, whose functions are looked up when they are called."""
    return {"curve": library}


def _exponents(route: Route) -> Iterator[Member]:
    return (Member(f"gamma {exponent:g}", exponent) for exponent in (1.0, 1.8, 2.2, 3.0))


@case("C1", "gamma of light of either sign", subjects=curves, family=_exponents, routes=_BOTH)
def there_and_back(tested: Any, exponent: float, route: Route) -> Iterator[Measured]:
    """C1: a power has no value below zero. The curve is odd and loses nothing."""
    light = route.arrive(_LIGHT)
    there = np.asarray(tested.curve(light, exponent))
    back = np.asarray(tested.uncurve(there, exponent), np.float64)
    lit = light != 0
    # Logarithms of up to 14 are multiplied by gamma before they are raised again.
    unit = 14 * exponent * route.eps
    yield Measured(float(np.abs(back[lit] / light[lit] - 1).max()), 10 * unit, unit)
    yield Measured(float(np.abs(back[~lit]).max()), 0.0)
    mirrored = np.asarray(tested.curve(-light, exponent))
    yield Measured(float(np.abs(mirrored[lit] / there[lit] + 1).max()), 4 * route.eps)


@case("C1", "slope of gamma at black", kind=Kind.GRADIENT, subjects=curves, family=_exponents, routes=_BOTH)
def slope(tested: Any, exponent: float, route: Route) -> Iterator[Measured]:
    """C1: a signed power is infinitely steep at 0. Against toe^(1/γ − 1) / γ there, and differences elsewhere."""
    zero = route.arrive(0.0)
    for function, wanted in (
        (tested.curve, library.TOE ** (1 / exponent - 1) / exponent),
        (tested.uncurve, library.TOE ** (1 - 1 / exponent) * exponent),
    ):
        found = float(jax.grad(function)(zero, exponent))
        yield Measured(abs(found / wanted - 1), route.gradient_tolerance)
        for value in (-3.0, -library.TOE, 0.3 * library.TOE, 7.0):
            step = 1e-4 * (abs(value) + library.TOE)
            difference = float(function(value + step, exponent) - function(value - step, exponent)) / (2 * step)
            found = float(jax.grad(function)(route.arrive(value), exponent))
            yield Measured(abs(found / difference - 1), route.gradient_tolerance)
