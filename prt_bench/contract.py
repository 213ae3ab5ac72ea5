"""What every method must keep, as plain checks: `prt-bench check-method NAME` and the contract tests run the same ones.

Each check takes a method and a dataset and returns a sentence that says what it measured; it raises `BrokenContract` where the
contract does not hold.
"""

import tempfile
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from prt_bench.dataset import LightingDataset
from prt_bench.errors import FitError
from prt_bench.example import example_dataset
from prt_bench.methods.base import Method

__all__ = ["CHECKS", "BrokenContract", "Finding", "check", "example_dataset"]


class BrokenContract(AssertionError):
    """A method does not keep the contract."""


class Finding(NamedTuple):
    """The outcome of one check."""

    name: str
    passed: bool
    detail: str


def check(method: Method, ds: LightingDataset | None = None) -> list[Finding]:
    """Run every check on a method, on the cube room unless told otherwise. Never raises for what a method does wrong."""
    ds = example_dataset(walls=5) if ds is None else ds
    return [_run(name, holds, method, ds) for name, holds in CHECKS.items()]


def _run(name: str, holds: Callable[[Method, LightingDataset], str], method: Method, ds: LightingDataset) -> Finding:
    try:
        return Finding(name, True, holds(method, ds))
    except BrokenContract as broken:
        return Finding(name, False, str(broken))
    except Exception as error:  # a plug-in may fail in any way; the report says where
        return Finding(
            name, False, f"{type(error).__name__}: {error} ({traceback.extract_tb(error.__traceback__)[-1]})"
        )


def shapes(method: Method, ds: LightingDataset) -> str:
    """[N, *, C] through all stages, and predict is their composition."""
    model, test = method.fit(ds.split("train")), ds.split("test")
    x = model.measure(test)
    u = model.transfer(x)
    y = model.reconstruct(u)
    lightings, receivers, channels = test.indirect.shape
    _require(y.shape == test.indirect.shape, f"reconstruct gives {y.shape}, not {test.indirect.shape}")
    sets = u.shape[2] in (1, channels)
    _require(u.shape[0] == lightings and sets, f"transfer gives {u.shape}, not [N, B, C] or [N, B, 1]")
    _close(model.predict(test), y, 0.0, "predict and reconstruct∘transfer∘measure")
    return f"[{lightings}, {u.shape[1]}, {u.shape[2]}] coefficients for {receivers} receivers"


def transforms(method: Method, ds: LightingDataset) -> str:
    """Stages can be jitted and vmapped over lightings without changing their values."""
    model = method.fit(ds.split("train"))
    x = jnp.asarray(model.measure(ds.split("test")), jnp.float64)
    for name, stage, argument in (
        ("transfer", model.transfer, x),
        ("reconstruct", model.reconstruct, model.transfer(x)),
    ):
        plain = stage(argument)
        _close(jax.jit(stage)(argument), plain, 1e-10, f"{name} under jit")
        _close(jax.vmap(lambda row, f=stage: f(row[None])[0])(argument), plain, 1e-10, f"{name} under vmap")
    return "jit and vmap agree with plain calls"


def gradients(method: Method, ds: LightingDataset) -> str:
    """The gradient of the prediction with respect to the observation matches central differences, and is finite at black."""
    model = method.fit(ds.split("train"))
    x = jnp.asarray(model.measure(ds.split("test")), jnp.float64)[:2]
    rng = np.random.default_rng(0)
    weight = jnp.asarray(rng.normal(size=model.reconstruct(model.transfer(x)).shape))

    def loss(x: jax.Array) -> jax.Array:
        return jnp.sum(weight * model.reconstruct(model.transfer(x)))

    direction = jnp.asarray(rng.normal(size=x.shape)) * jnp.max(jnp.abs(x))
    step = 1e-6
    difference = (loss(x + step * direction) - loss(x - step * direction)) / (2 * step)
    slope = jnp.vdot(jax.grad(loss)(x), direction)
    scale = float(jnp.linalg.norm(jax.grad(loss)(x)) * jnp.linalg.norm(direction))
    _require(
        bool(jnp.all(jnp.isfinite(jax.grad(loss)(jnp.zeros_like(x))))), "the gradient at black light is not finite"
    )
    gap = abs(float(slope - difference)) / max(scale, 1e-300)
    _require(gap < 1e-6, f"the gradient is off by {gap:.1e} of its size against central differences")
    return f"off by {gap:.1e} against central differences, finite at black"


def homogeneous(method: Method, ds: LightingDataset) -> str:
    """f(a x) = a f(x): twice the light gives twice the answer."""
    model = method.fit(ds.split("train"))
    x = jnp.asarray(model.measure(ds.split("test")), jnp.float64)
    plain = model.reconstruct(model.transfer(x))
    worst = 0.0
    for factor in (1e-6, 0.5, 3.0, 1e6):
        scaled = model.reconstruct(model.transfer(factor * x))
        worst = max(worst, _close(scaled / factor, plain, 1e-9, f"f({factor:g} x) / {factor:g} and f(x)"))
    return f"holds to {worst:.1e}"


def black(method: Method, ds: LightingDataset) -> str:
    """No light gives exactly none, and black lightings in the training split change nothing."""
    train = ds.split("train")
    model = method.fit(train)
    x = jnp.zeros_like(jnp.asarray(model.measure(ds.split("test"))))
    _require(not bool(jnp.any(model.reconstruct(model.transfer(x)))), "a black lighting is not predicted as exactly 0")
    lit = np.flatnonzero(np.any(train.measured, axis=(1, 2)))
    _close(
        method.fit(_lightings(train, lit)).predict(ds.split("test")),
        model.predict(ds.split("test")),
        1e-8,
        "fits without black",
    )
    return f"0 for black light; {len(train) - len(lit)} black training lightings left out without a trace"


def permutation(method: Method, ds: LightingDataset) -> str:
    """The order of the training lightings does not matter, and the same fit twice gives the same bits."""
    train, test = ds.split("train"), ds.split("test")
    plain = method.fit(train, key=jax.random.key(0)).predict(test)
    _close(method.fit(train, key=jax.random.key(0)).predict(test), plain, 0.0, "two fits of the same data")
    shuffled = _lightings(train, np.random.default_rng(0).permutation(len(train)))
    gap = _close(method.fit(shuffled, key=jax.random.key(0)).predict(test), plain, 1e-8, "fits of shuffled lightings")
    return f"deterministic; shuffled lightings change {gap:.1e}"


def one_channel(method: Method, ds: LightingDataset) -> str:
    """A model fitted on one channel predicts any number, each channel by itself."""
    grey = {**ds.metadata, "channels": 1}
    arrays = {name: values[..., :1] if values.ndim == 3 else values for name, values in ds.arrays.items()}
    single = replace(ds, arrays=arrays, metadata=grey)
    model = method.fit(single.split("train"))
    coloured = model.predict(ds.split("test"))
    _require(coloured.shape == ds.split("test").indirect.shape, f"three channels come out as {coloured.shape}")
    _close(coloured[..., :1], model.predict(single.split("test")), 1e-10, "a channel alone and among others")
    return "one-channel fit predicts three channels"


def ships(method: Method, ds: LightingDataset) -> str:
    """The asset loaded back predicts what the model predicts, to the precision it is stored in."""
    model, test = method.fit(ds.split("train")), ds.split("test")
    if not model.kernels:
        return "an oracle, which ships nothing"
    plain, found = model.predict(test), []
    with tempfile.TemporaryDirectory() as folder:
        for dtype, tolerance in (("float32", 2e-5), ("float16", 5e-3)):
            asset = model.export(Path(folder) / dtype, dtype)
            found.append(
                f"{dtype} {_close(asset.predict(test), plain, tolerance, f'the {dtype} asset and the model'):.1e}"
            )
    return "asset against model: " + ", ".join(found)


def fit_gradient(method: Method, ds: LightingDataset) -> str:
    """The prediction is differentiable in the training light, duplicates and black lightings included; or it says it is not."""
    train, test = ds.split("train"), ds.split("test")
    measured, indirect = (np.asarray(light, np.float64).copy() for light in (train.measured, train.indirect))
    measured[2], indirect[2] = measured[3], indirect[3]
    rng = np.random.default_rng(0)
    weight = jnp.asarray(rng.normal(size=test.indirect.shape))
    fixed = {
        name: getattr(train, name)
        for name in ("transport", "measurement_points", "dense_points", "groups", "metadata", "streamed")
    }

    def loss(measured: jax.Array, indirect: jax.Array) -> jax.Array:
        return jnp.sum(
            weight * method.fit(SimpleNamespace(**fixed, measured=measured, indirect=indirect)).predict(test)
        )

    if not method.differentiable:
        try:
            jax.grad(loss)(jnp.asarray(measured), jnp.asarray(indirect))
        except FitError as refusal:
            return f"not offered, and refused: {refusal}"
        raise BrokenContract("derivatives of the fit are declared as not offered, but one was returned")
    slopes = jax.grad(loss, argnums=(0, 1))(jnp.asarray(measured), jnp.asarray(indirect))
    _require(all(bool(jnp.all(jnp.isfinite(slope))) for slope in slopes), "the gradient has values that are not finite")
    return "finite"


CHECKS: dict[str, Callable[[Method, LightingDataset], str]] = {
    "shapes": shapes,
    "transforms": transforms,
    "gradients": gradients,
    "homogeneous": homogeneous,
    "black": black,
    "permutation": permutation,
    "one channel": one_channel,
    "ships": ships,
    "fit gradient": fit_gradient,
}


def _lightings(ds: LightingDataset, rows: np.ndarray) -> LightingDataset:
    """Some lightings of a split, in a given order, as a dataset in memory."""
    arrays = {name: getattr(ds, name)[rows] for name in ("measured", "direct", "indirect", "noise")}
    arrays |= {name: ds.arrays[name] for name in ds.arrays if name.startswith("streamed")}
    lights = tuple(ds.lightings[row] for row in rows)
    everything = (0, len(rows))
    return replace(ds, arrays=arrays, all_lightings=lights, splits={"train": everything}, rows=everything)


def _require(condition: bool, otherwise: str) -> None:
    if not condition:
        raise BrokenContract(otherwise)


def _close(found: jax.Array | np.ndarray, wanted: jax.Array | np.ndarray, tolerance: float, what: str) -> float:
    """Largest difference over the largest value wanted."""
    found, wanted = np.asarray(found, np.float64), np.asarray(wanted, np.float64)
    _require(bool(np.all(np.isfinite(found))), f"{what}: values are not finite")
    gap = float(np.max(np.abs(found - wanted), initial=0.0) / max(np.max(np.abs(wanted), initial=0.0), 1e-300))
    _require(gap <= tolerance, f"{what} differ by {gap:.1e}, more than {tolerance:.0e}")
    return gap
