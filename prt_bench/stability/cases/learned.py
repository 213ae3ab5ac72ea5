"""What only training meets: dark targets, targets of any size, updates that are not finite, weights in half precision."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.learned import losses
from prt_bench.learned.networks import Network, homogeneous
from prt_bench.learned.training import Schedule, train
from prt_bench.stability import rigs
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.routes import F32, F64, Route

_SCHEDULE = Schedule(epochs=60, batch=16, rate=2e-2, chunks=6, patience=6)
_TRAINED_ROUTES = (F64, F32)


class _Light(NamedTuple):
    x: jax.Array
    targets: jax.Array


def relative_losses() -> dict[str, Any]:
    """Losses that divide by the light."""
    return {"relative": losses.relative_square}


def _dark(route: Route) -> Iterator[Member]:
    rng = np.random.default_rng(0)
    bright = rng.exponential(size=(40, 3))
    for name, share in (("all dark", 1.0), ("half dark", 0.5), ("one dark", 1 / 40)):
        light = bright * (np.arange(40) >= 40 * share)[:, None]
        for scale in (1.0, 1e-12, 1e12):
            yield Member(f"{name}, × {scale:g}", (scale * light).astype(route.compute))


@case("E1", "relative loss of dark texels", subjects=relative_losses, family=_dark, routes=_TRAINED_ROUTES)
def dark_texels(loss: Any, target: np.ndarray, route: Route) -> Iterator[Measured]:
    """E1: a prediction of darkness for darkness has a finite loss and slope; a tenth too much of any light a loss below one."""
    size = jnp.sqrt(jnp.mean(target**2))
    for prediction in (0.0 * target, 1.1 * target):
        value, slope = jax.value_and_grad(loss)(jnp.asarray(prediction), jnp.asarray(target), size)
        yield Measured(0.0 if bool(jnp.isfinite(value) & jnp.all(jnp.isfinite(slope))) else np.nan, 1.0)
        yield Measured(float(value), 1.0 + 8 * route.eps)


@case(
    "E1",
    "derivative of a relative loss",
    kind=Kind.GRADIENT,
    subjects=relative_losses,
    family=_dark,
    routes=_TRAINED_ROUTES,
)
def dark_slopes(loss: Any, target: np.ndarray, route: Route) -> Iterator[Measured]:
    """E1: the slope is that of squares over constants, so it points from the prediction to the target and nowhere else."""
    prediction = jnp.asarray(0.5 * target + 0.1 * target.max())
    slope = jax.grad(loss)(prediction, jnp.asarray(target), jnp.sqrt(jnp.mean(target**2)))
    towards = prediction - target
    cosine = jnp.sum(slope * towards, axis=1) / (jnp.linalg.norm(slope, axis=1) * jnp.linalg.norm(towards, axis=1))
    if target.any():
        yield Measured(float(jnp.max(1.0 - cosine)), 64 * route.eps)


def networks() -> dict[str, Any]:
    """Fits of a residual network to examples: its weights, in the order of `train`, and the scale that they were trained at."""

    def fitted(light: _Light) -> tuple[Network, jax.Array]:
        scale = losses.power_of_two(jnp.sqrt(jnp.mean(light.targets.astype(jnp.float64) ** 2)))
        light = _Light(jnp.asarray(light.x, jnp.float32), jnp.asarray(light.targets / scale, jnp.float32))
        start = Network.random(jax.random.key(0), [light.x.shape[1], 8]), jnp.zeros((1, 2, 8), jnp.float32)
        network, head = train(start, None, light, light, _loss, _score, _SCHEDULE, jax.random.key(1), "network").weights
        return network, head * scale

    return {"residual network": fitted}


def _loss(weights: tuple[Network, jax.Array], fixed: None, batch: _Light, key: jax.Array) -> jax.Array:
    return jnp.mean((homogeneous(*weights, batch.x) - batch.targets) ** 2)


def _score(weights: tuple[Network, jax.Array], fixed: None, held: _Light) -> jax.Array:
    return _loss(weights, None, held, jax.random.key(0))


def _examples(route: Route, rows: int = 48) -> _Light:
    rng = np.random.default_rng(0)
    x = rng.exponential(size=(rows, 5, 1))
    targets = np.stack([np.linalg.norm(x[:, :2, 0], axis=1), np.max(x[:, :, 0], axis=1)], axis=1)[:, :, None]
    return _Light(jnp.asarray(route.arrive(x)), jnp.asarray(route.arrive(targets)))


def _sized(route: Route) -> Iterator[Member]:
    for power in (-40, -20, 66, 100):  # 1e-12 to 1e30
        yield Member(f"targets × 2^{power}", power)


@case("E2", "targets of extreme scale", subjects=networks, family=_sized, routes=_TRAINED_ROUTES)
def any_scale(fit: Any, power: int, route: Route) -> Iterator[Measured]:
    """E2: training learns what it learns at scale one, to the last bit, for the size of the targets is taken out first."""
    light = _examples(route)
    plain, head = fit(light)
    _, scaled = fit(light._replace(targets=jnp.ldexp(light.targets, power)))
    yield Measured(float(jnp.max(jnp.abs(jnp.ldexp(scaled, -power) - head))), 0.0)
    error = jnp.sqrt(jnp.mean((homogeneous(plain, head, light.x) - light.targets) ** 2) / jnp.mean(light.targets**2))
    yield Measured(float(error), 0.1)


def _poisoned(route: Route) -> Iterator[Member]:
    light = _examples(route)
    for name, bad in (("infinite", np.inf), ("NaN", np.nan)):
        yield Member(f"one {name} target", light._replace(targets=light.targets.at[3, 0, 0].set(bad)))


@case("E3", "one update that is not finite", subjects=networks, family=_poisoned, routes=_TRAINED_ROUTES)
def one_bad_update(fit: Any, light: _Light, route: Route) -> Iterator[Measured]:
    """E3: batches with a target that is not finite are left out, and the others teach the network all the same."""
    sound = _examples(route)
    scale = losses.power_of_two(jnp.sqrt(jnp.mean(sound.targets**2)))
    start = Network.random(jax.random.key(0), [5, 8]), jnp.zeros((1, 2, 8), jnp.float32)
    light = _Light(jnp.asarray(light.x, jnp.float32), jnp.asarray(light.targets / scale, jnp.float32))
    held = _Light(jnp.asarray(sound.x, jnp.float32), jnp.asarray(sound.targets / scale, jnp.float32))
    schedule = Schedule(epochs=400, batch=16, rate=2e-2, chunks=6, patience=6)
    trained = train(start, None, light, held, _loss, _score, schedule, jax.random.key(1), "network")
    yield Measured(0.0 if trained.skipped > 0 else 1.0, 0.5)
    yield Measured(float(np.sqrt(trained.history["validation_error"].min() / np.mean(held.targets**2))), 0.1)


def _random_networks() -> dict[str, Any]:
    return {"network": Network.random}


def _widths(route: Route) -> Iterator[Member]:
    yield from (Member(f"width {width}", width) for width in (4, 32, 128))


@case("B9", "networks in half precision", subjects=_random_networks, family=_widths, routes=(F32,))
def half_precision(random: Any, width: int, route: Route) -> Iterator[Measured]:
    """B9: weights rounded to float16 change a network by their rounding along its paths, and by no more."""
    x = jnp.asarray(np.random.default_rng(0).exponential(size=(20, 24, 3)), route.compute)
    network = random(jax.random.key(0), [24, width, width])
    head = jax.random.normal(jax.random.key(1), (3, 6, width), route.compute)
    narrow = jax.tree.map(lambda leaf: leaf.astype(jnp.float16).astype(route.compute), (network, head))
    plain, found = homogeneous(network, head, x), homogeneous(narrow[0], narrow[1], x)
    sizes = jax.tree.map(jnp.abs, (network, head))
    bound = homogeneous(sizes[0], sizes[1], jnp.abs(x))
    unit = float(jnp.finfo(jnp.float16).eps) / 2
    yield Measured(float(jnp.max(jnp.abs(found - plain) / (bound + rigs.BASIS))), 4 * unit)
