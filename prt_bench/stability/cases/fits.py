"""Every method on every rig: finite, shipped without loss, indifferent to what must not matter, near what its basis can do."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from prt_bench.gamma import GammaLinearModel, curve, over, uncurve
from prt_bench.learned.fields import FieldModel
from prt_bench.learned.models import ResidualModel
from prt_bench.learned.transfer import HarmonicFieldModel
from prt_bench.methods.base import Method
from prt_bench.models import LinearModel, Model
from prt_bench.stability import rigs
from prt_bench.stability.cell import Kind, Measured, Member, case
from prt_bench.stability.rigs import Rig, dataset, mixed, relit, subjects
from prt_bench.stability.routes import F32, F64, Route

_CLEAR = 1e-6
"""Relative to the largest singular value."""
EQUAL = 1e-9
"""Largest relative difference of two fits that must be the same but for rounding in float64."""


def difference(found: object, wanted: object) -> float:
    """Largest difference over the largest value wanted."""
    a, b = np.asarray(found, np.float64), np.asarray(wanted, np.float64)
    size = np.abs(b).max()
    return float(np.abs(a - b).max() / size) if size else float(np.abs(a).max())


def shipped(model: Model, test: object) -> tuple[np.ndarray, float]:
    """What the exported asset predicts, and the size of the numbers that it adds up."""
    with tempfile.TemporaryDirectory() as folder:
        asset = model.export(Path(folder) / "asset")
        found = asset.predict(test)
    if isinstance(model, LinearModel):
        return found, float(np.max(_terms(model, jnp.asarray(model.measure(test)))))  # pyright: ignore[reportArgumentType]
    if isinstance(model, GammaLinearModel):
        return found, float(np.max(_curved_terms(model, jnp.asarray(model.measure(test)))))  # pyright: ignore[reportArgumentType]
    if isinstance(model, FieldModel | HarmonicFieldModel | ResidualModel):
        return found, float(np.max(model.magnitudes(jnp.asarray(model.measure(test)))))  # pyright: ignore[reportArgumentType]
    return found, float(np.abs(found).max())


def _terms(model: LinearModel, x: Array) -> Array:
    """Sums of the sizes of what a prediction adds up."""
    sizes = LinearModel(jnp.abs(model.basis), jnp.abs(model.weights))
    return sizes.reconstruct(sizes.transfer(jnp.abs(x)))


def _curved_terms(model: GammaLinearModel, x: Array) -> Array:
    """The same in gamma space, where the way back multiplies an error by the slope of the curve."""
    size = model.size(x)
    corrected = curve(over(x, size), model.gamma[0], model.gamma[1])
    answer = model.inside.reconstruct(model.inside.transfer(corrected))
    slope = jax.vmap(jax.grad(lambda v: uncurve(v, model.gamma[0], model.gamma[1])))(answer.ravel())
    return size * slope.reshape(answer.shape) * _terms(model.inside, corrected)


@case("A13", "fitted in float64, shipped in float32", subjects=subjects, family=rigs.rigs)
def ships(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """A1 to A7: finite on every rig, and the asset differs by float32 rounding of its terms alone."""
    model = method.fit(rig.train)
    plain = np.asarray(model.predict(rig.test), np.float64)
    yield Measured(0.0 if np.all(np.isfinite(plain)) else np.nan, 1.0)
    if model.kernels:
        found, size = shipped(model, rig.test)
        unit = F32.eps * size
        yield Measured(float(np.abs(found - plain).max()), 8 * unit, unit)


@case("B3", "bounded answers", subjects=subjects, family=lambda route: rigs.rigs(route, (0, 1)))
def bounded(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """B3, A1b: light as bright as the training light is not predicted many times brighter, whatever the fit was given.

    What centring leaves of constant light is rounding; a ridge relative to *that* divides by rounding. Of light unlike any
    that a fit was given a ridge promises less than this; it is asked of it nevertheless, but for the published
    normalisation, whose answers are held to the ridge's promise alone.
    """
    found = np.asarray(method.fit(rig.train).predict(rig.test), np.float64)
    if _as_published(method):
        lengths, promised = np.linalg.norm(found, axis=1), _promised(method, rig)
        yield from (Measured(float(a), float(b)) for a, b in zip(lengths.ravel(), promised.ravel(), strict=True))
    else:
        yield Measured(float(np.abs(found).max()), 10.0 * float(rig.test.indirect.max()))


def _as_published(method: Method) -> bool:
    return rigs.settings(method).get("normalise") == "measured"


def _promised(method: Method, rig: Rig) -> np.ndarray:
    """The largest length [N, C] of an answer that a ridge allows.

    σ / (σ² + λ) ≤ 1 / (2 √λ), so with λ = λ̂ ‖X‖² / M no matrix fitted to normalised light Y is longer than
    ‖Y‖ / (2 √λ) = ½ √(M / λ̂) ‖Y‖ / ‖X‖, and ‖Y‖ / ‖X‖ is at most the largest ‖y‖ / ‖x‖ of a lighting. Its own mean adds
    that much once more, and what is left of x without it is at most twice as long.
    """
    x, y, test = (
        np.linalg.norm(np.asarray(light, np.float64), axis=1)
        for light in (rig.train.measured, rig.train.indirect, rig.test.measured)
    )
    most = np.max(y[x > 0] / x[x > 0])
    amplified = 0.5 * np.sqrt(rig.train.measured.shape[1] / rigs.settings(method)["ridge"])
    return (1.0 + 2.0 * amplified) * most * test


@case("A5", "unit of light", subjects=subjects, family=rigs.rigs)
def unit_of_light(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """A5: light in other units gives the same model; powers of two change no digit of the data."""
    plain = method.fit(rig.train).predict(rig.test)
    for factor in (route.compute(2.0**-10), route.compute(2.0**20)):
        scaled = relit(rig.train, factor * rig.train.measured, factor * rig.train.indirect)
        yield Measured(difference(method.fit(scaled).predict(rig.test), plain), EQUAL)


@case("C4", "f(a x) = a f(x)", subjects=subjects, family=rigs.rigs)
def homogeneous(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """C4, A6: homogeneous over twelve decades, and exactly black for no light."""
    model = method.fit(rig.train)
    x = jnp.asarray(model.measure(rig.test), jnp.float64)
    plain = model.reconstruct(model.transfer(x))
    for factor in (1e-6, 3.0, 1e6):
        yield Measured(difference(model.reconstruct(model.transfer(factor * x)) / factor, plain), EQUAL)
    yield Measured(float(np.abs(model.reconstruct(model.transfer(0.0 * x))).max()), 0.0)


def _plain(route: Route) -> Iterator[Member]:
    return rigs.named("plain", route, (0, 1))


@case("A6", "black lightings", subjects=subjects, family=_plain)
def black(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """A6: they change nothing, wherever they stand among the others."""
    measured, indirect = (np.repeat(light, 2, axis=0) for light in (rig.train.measured, rig.train.indirect))
    measured[::2], indirect[::2] = 0.0, 0.0
    with_black = method.fit(relit(rig.train, measured, indirect)).predict(rig.test)
    yield Measured(difference(with_black, method.fit(rig.train).predict(rig.test)), EQUAL)


@case("A7", "intensities of twelve decades", subjects=subjects, family=_plain, routes=(F64, F32))
def intensities(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """A7: no lighting is lost beside the brightest; the worst relative error of a lighting stays what it was."""
    factors = 2.0 ** np.linspace(-20, 20, rigs.LIGHTINGS).round().astype(route.compute)[:, None, None]
    scaled = relit(rig.train, factors * rig.train.measured, factors * rig.train.indirect)
    worst = []
    for train in (rig.train, scaled):
        found, wanted = np.asarray(method.fit(train).predict(train), np.float64), train.indirect.astype(np.float64)
        size = np.linalg.norm(wanted, axis=(1, 2))
        worst.append(np.max(np.linalg.norm(found - wanted, axis=(1, 2)) / size))
    yield Measured(float(worst[1]), float(1.05 * worst[0] + 30 * route.eps))


_RANK = 8


def _low_rank(route: Route) -> Iterator[Member]:
    """Mixtures of `_RANK` lights in one channel: what is measured determines the light."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        splits = []
        for count in (rigs.LIGHTINGS, 12):
            weights = (
                rng.uniform(0, 1, (count, rigs.LIGHTINGS - 1, 1)) ** 3
                * (np.arange(rigs.LIGHTINGS - 1) < _RANK)[:, None]
            )
            splits.append([route.arrive(light[..., :1]) for light in mixed(np.repeat(weights, 3, axis=2))])
        (x, y), (test_x, test_y) = splits
        rig = Rig(dataset(x, y), dataset(test_x, test_y, "test"), (x, y))
        yield Member(f"seed {seed}", rig)


_LEARN_ELSEWHERE = ("clustered-pca", "reduced-rank", "streamed-ridge")
"""Methods with a ridge that fit streamed lightings besides the rig's, whose light the rig's measurements do not determine.

Learned methods have no ridge, train on streamed lightings too, and are not asked: on this family `mlp-coefficients` and
`linear-finetuned` miss the bound (0.04 where rounding is allowed).
"""


def _fitting() -> dict[str, Method]:
    return {
        f"{label}, {size} functions": method
        for size in (12, 4)
        for label, method in subjects("method", basis=size, ridge=1e-12, prior=0.0).items()
        if "ridge" in rigs.settings(method) and method.name not in _LEARN_ELSEWHERE
    }


@case("A8", "error near the projection", subjects=_fitting, family=_low_rank)
def near_projection(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """A8, A9: normalising or centring one side alone costs many times what the basis leaves; so does a float32 fit, whose
    basis leaves more than rounding even where there are more functions than lights.

    With a ridge of 1e-12 data in another precision carry an error of their own, and amplify it.
    """
    model = method.fit(rig.train)
    found, wanted = np.asarray(model.predict(rig.test), np.float64), rig.test.indirect.astype(np.float64)
    if model.span is None:  # no span holds what a curve makes of coefficients
        return
    u = np.linalg.qr(np.asarray(model.span))[0]
    best = wanted - np.einsum("tb,sb,nsc->ntc", u, u, wanted, optimize=True)
    e_rec, e_proj = (np.linalg.norm(part) / np.linalg.norm(wanted) for part in (found - wanted, best))
    rounding = 300 * route.data_eps + 1e-9
    if u.shape[1] > _RANK:
        yield Measured(float(e_proj), rounding)
    yield Measured(float(max(e_proj - e_rec, 0.0)), 1e-6)
    yield Measured(float(e_rec), float(1.5 * e_proj + rounding))


def _apart() -> dict[str, Method]:
    coupled = _coupled()
    return {label: each for label, each in subjects().items() if label not in coupled}


def _coupled() -> dict[str, Method]:
    return {label: each for label, each in subjects().items() if rigs.settings(each).get("transfer") == "coupled"}


@case("H3", "white light in training, red light at test", subjects=_apart, routes=(F64, F32),
      family=lambda route: rigs.named("white", route, (0, 1)))  # fmt: skip
def red_light(method: Method, rig: Rig, route: Route) -> Iterator[Measured]:
    """H3: channels are examples of one map; red light is predicted as the red of white light, and nothing else lights up."""
    model = method.fit(rig.train)
    red = np.array([1.0, 0.0, 0.0], route.compute)
    white = np.asarray(model.predict(rig.test))
    found = model.predict(relit(rig.test, rig.test.measured * red, rig.test.indirect * red))
    yield Measured(difference(found, white * red), EQUAL)


@case("H3", "white light for coupled channels", kind=Kind.REFUSAL, subjects=_coupled, routes=(F64, F32),
      family=lambda route: rigs.named("white", route, (0, 1)))  # fmt: skip
def one_colour(method: Method, rig: Rig, route: Route) -> bool:
    """H3: channels that are parts of one vector know the colours they were fitted to alone, and the fit says so."""
    method.fit(rig.train)
    return False


def _unusable(route: Route) -> Iterator[Member]:
    plain = next(rigs.named("plain", route, (0,)))
    train = plain.data.train
    light = {name: getattr(train, name) for name in ("measured", "indirect")}
    yield Member(
        "all black", plain.data._replace(train=relit(train, **{name: 0 * value for name, value in light.items()}))
    )
    for name, value in light.items():
        for bad in (np.nan, np.inf):
            damaged = value.copy()
            damaged[3, 2, 1] = bad
            yield Member(f"{bad} in {name}", plain.data._replace(train=relit(train, **{**light, name: damaged})))


def _fitted_at_all() -> dict[str, Method]:
    return {label: method for label, method in subjects(variants=False).items() if method.role != "ceiling"}


@case("A6", "no light, NaN and infinity", kind=Kind.REFUSAL, subjects=_fitted_at_all, family=_unusable)
def unusable(method: Method, rig: Rig, route: Route) -> bool:
    """A6: nothing can be learned from such light, and the fit says so."""
    method.fit(rig.train)
    return False


def _on_a_basis(basis: int = rigs.BASIS, **wished: bool) -> dict[str, Method]:
    found = subjects("method", basis=basis, **wished)
    return {label: method for label, method in found.items() if "basis" in rigs.settings(method)}


@case(
    "B2", "more functions than the light has rank", kind=Kind.REFUSAL, subjects=_on_a_basis,
    family=lambda route: rigs.named("constant", route, (0, 1)),
)  # fmt: skip
def short_of_rank(method: Method, rig: Rig, route: Route) -> bool:
    """B2, B3: one lighting repeated has a rank of one per channel; the fit warns of the functions that are left empty."""
    method.fit(rig.train)
    return False


def _without_mean() -> dict[str, Method]:
    """Methods with one basis for the scene: those with one for each cluster cut as many spectra, of streamed light."""
    found = _on_a_basis(rigs.BASIS - 1, mean=False)
    single = {label: each for label, each in found.items() if "clusters" not in rigs.settings(each)}
    return {label: each for label, each in single.items() if not rigs.settings(each).get("mean", False)}


@case(
    "B4", "a cut through equal singular values", kind=Kind.REFUSAL, subjects=_without_mean,
    family=lambda route: rigs.named("symmetric", route, (0, 1)),
)  # fmt: skip
def arbitrary_cut(method: Method, rig: Rig, route: Route) -> bool:
    """B4, B5: an odd number of functions of a symmetric rig is arbitrary; the fit warns of it.

    A method whose functions come from other light than the rig's has a clear cut there, and says so by its values.
    """
    model: Any = method.fit(rig.train)
    values, cut = np.asarray(model.singular_values), model.basis.shape[1]
    return bool(values[cut - 1] - values[cut] > _CLEAR * values[0])
