"""Lighting datasets that are hard to fit, all on a cube room with its traced operator, and the methods to fit to them.

Light is linear, so every rig is a mixture of the room's point lights: exact for every method, those with a prior included.
The room is closed, or open at the front: there some lightings light next to nothing that is measured.
"""

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import Float

from prt_bench.dataset import LightingDataset, Streamed
from prt_bench.errors import SpecError
from prt_bench.example import example_dataset
from prt_bench.methods import methods
from prt_bench.methods.base import Method
from prt_bench.stability.cell import Member
from prt_bench.stability.routes import Route

LIGHTINGS = MEASUREMENTS = 24
BASIS = 6
"""Even, since the symmetric rig has every singular value twice."""
_CURVED = {"gamma": (2.2,)}
"""Numbers among the settings that change the form of the model, and one to try."""
CLOSED, OPEN = 6, 5
"""Walls of the room."""
_IN_THE_OPEN = ("plain", "dark", "symmetric")
_FIXED = ("transport", "measurement_points", "dense_points", "groups", "metadata", "lightings", "streamed")


class Rig(NamedTuple):
    """Training and test light as they arrived, and a direction [measured, indirect] that keeps the rig what it is."""

    train: SimpleNamespace
    test: SimpleNamespace
    tangent: tuple[np.ndarray, np.ndarray]


@cache
def room(walls: int = CLOSED) -> LightingDataset:
    """The cube room under point lights; where it is open distant light comes in at the front."""
    return example_dataset(texels=4, lightings=LIGHTINGS, measurements=MEASUREMENTS, rays=32, walls=walls)


@cache
def _white(split: str, walls: int) -> tuple[Float[np.ndarray, "L M"], Float[np.ndarray, "L T 3"]]:
    """Measured and indirect light of the room's lights, as if each were white and of intensity 1."""
    ds = room(walls).split(split)
    colour = np.array([np.asarray(vars(lighting.lights[0])["intensity"], float) for lighting in ds.lightings])
    lit = np.all(colour > 0, axis=1)
    return ds.measured[lit, :, 0] / colour[lit, :1], ds.indirect[lit] / colour[lit, None]


def mixed(
    weights: Float[np.ndarray, "N L 3"], split: str = "train", walls: int = CLOSED
) -> tuple[np.ndarray, np.ndarray]:
    """Measured [N, M, 3] and indirect [N, T, 3] light of mixtures of the room's lights."""
    measured, indirect = _white(split, walls)
    weights = weights[:, : len(measured)]
    return np.einsum("nlc,lm->nmc", weights, measured), np.einsum("nlc,ltc->ntc", weights, indirect)


def dataset(measured: Any, indirect: Any, split: str = "train", walls: int = CLOSED) -> SimpleNamespace:
    """Light in the room as methods take it: all that a fit may look at. The arrays may be traced."""
    ds = room(walls).split(split)
    fixed = {name: getattr(ds, name) for name in _FIXED}
    return SimpleNamespace(**fixed, measured=measured, indirect=indirect, indirect_half=indirect)


def relit(ds: SimpleNamespace, measured: Any, indirect: Any) -> SimpleNamespace:
    """A rig's dataset with other light, and everything else as it is."""
    return SimpleNamespace(**{**vars(ds), "measured": measured, "indirect": indirect, "indirect_half": indirect})


def _weights(seed: int) -> dict[str, Float[np.ndarray, "N L 3"]]:
    """Mixtures by name. The room has one black lighting, so one light fewer than lightings."""
    rng = np.random.default_rng(seed)
    lights = LIGHTINGS - 1
    alone = np.eye(LIGHTINGS)[:, :lights, None]
    alone[-1, 0] = 0.5
    colour = rng.uniform(0.2, 1.0, (LIGHTINGS, 1, 3))
    n = np.arange(LIGHTINGS)
    few = rng.uniform(0, 1, (LIGHTINGS, lights, 3)) * (np.arange(lights) < 4)[:, None]
    return {
        "plain": alone * colour,
        "duplicated": (alone * colour)[n // 2],
        "dark": alone * colour * (n % 3 > 0)[:, None, None],
        "rank-deficient": few,
        "intensities 1e-6 to 1e6": alone
        * colour
        * 10.0 ** np.linspace(-6, 6, LIGHTINGS)[rng.permutation(n), None, None],
        "white": alone * colour[..., :1] * np.ones(3),
        "constant": np.repeat((alone * colour)[:1], LIGHTINGS, axis=0),
    }


def rigs(route: Route, seeds: tuple[int, ...] = (0,)) -> Iterator[Member]:
    """Every rig for each seed, in the closed room and some in the open one.

    Where the dtype cannot hold the light, the rig is ill-posed.
    """
    for seed in seeds:
        for walls in (CLOSED, OPEN):
            for name, weights in {**_weights(seed), "symmetric": _weights(seed)["plain"]}.items():
                if walls == CLOSED or name in _IN_THE_OPEN:
                    measured, indirect = _light(name, weights, walls)
                    yield _member(name, measured, indirect, route, seed, walls)


def named(name: str, route: Route, seeds: tuple[int, ...]) -> Iterator[Member]:
    """The rigs of one name."""
    return (member for member in rigs(route, seeds) if member.name.startswith(name))


def _light(name: str, weights: Float[np.ndarray, "N L 3"], walls: int) -> list[np.ndarray]:
    """Measured and indirect light of a rig's mixtures, and what its name does to points besides."""
    light = list(mixed(weights, walls=walls))
    if name == "duplicated":
        light[0][:, 1] = light[0][:, 0]
    if name == "symmetric":
        halves = [part[: LIGHTINGS // 2, ::2] for part in light]
        light = [np.concatenate([_beside(half, side) for side in (0, 1)]) for half in halves]
    return light


def _beside(half: np.ndarray, side: int) -> np.ndarray:
    """Light on one of two mirrored halves of the points, the other one dark."""
    return np.concatenate([half, 0.0 * half][:: -1 if side else 1], axis=1)


def _member(name: str, measured: np.ndarray, indirect: np.ndarray, route: Route, seed: int, walls: int) -> Member:
    rng = np.random.default_rng([seed, 9])
    test = mixed(np.eye(12)[:, :, None] * rng.uniform(0.2, 1.0, (12, 1, 3)), "test", walls)
    x, y = route.arrive(measured), route.arrive(indirect)
    finite = bool(np.all(np.isfinite(x)) and np.all(np.isfinite(y)))
    constant = name == "constant"
    change_x, change_y = (rng.normal(size=light[:1].shape if constant else light.shape) for light in (x, y))
    tangent = (change_x * x, change_y * y) if finite else (x, y)
    train = dataset(x, y, walls=walls)
    if constant:
        train.streamed = Streamed(*(np.repeat(light[:1], len(light), axis=0) for light in train.streamed))
    rig = Rig(train, dataset(route.arrive(test[0]), route.arrive(test[1]), "test", walls), tangent)
    return Member(f"{name}, seed {seed}{', open' if walls == OPEN else ''}", rig, ill_posed=not finite)


def subjects(role: str | None = None, variants: bool = True, **wished: Any) -> dict[str, Method]:
    """Every method that learns by label, and its variants: each choice and each switch among the settings, one at a time.

    Ceilings without settings are left out: they fit nothing. `wished` settings are given to the methods that have them.
    """
    return _labelled(role, variants, True, wished)


def unlearned() -> dict[str, Method]:
    """Methods that do not look at lightings, with their variants: what they fit is the transport."""
    return _labelled(None, True, False, {})


def _labelled(role: str | None, variants: bool, learns: bool, wished: dict[str, Any]) -> dict[str, Method]:
    found: dict[str, Method] = {}
    for kind in methods().values():
        if kind.learns != learns:
            continue
        own = {field.name for field in fields(kind)}
        if role not in (None, kind.role) or (kind.role == "ceiling" and not own):
            continue
        plain = kind(**{name: value for name, value in {"basis": BASIS, **wished}.items() if name in own})
        for method in (plain, *(_variants(plain) if variants else ())):
            found[method.label] = method
    return found


def settings(method: Method) -> dict[str, Any]:
    """The settings of a method by name."""
    return {field.name: getattr(method, field.name) for field in fields(method)}


def _variants(plain: Method) -> Iterator[Method]:
    hints = get_type_hints(type(plain))
    for field in fields(plain):
        hint = hints[field.name]
        choices = get_args(hint) if get_origin(hint) is Literal else (True, False) if hint is bool else ()
        choices = choices or _CURVED.get(field.name, ())
        for choice in choices:
            if choice != getattr(plain, field.name):
                try:
                    yield replace(plain, **{field.name: choice})
                except SpecError:
                    continue  # settings that exclude each other
