"""The chain from lights to indirect light: its values are the bake's, its gradients those of finite differences."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from data_gen.direct import direct_irradiance, visibility
from data_gen.tracer import Tracer
from prt_bench.chain import direct_light, indirect_light, measured_light
from prt_bench.errors import SpecError
from prt_bench.example import example_dataset
from prt_bench.lights import Lighting, PointLight, SpotLight, emitters
from prt_bench.methods.prior import mixed

DS = example_dataset(texels=4, lightings=24, rays=32)
TRAIN, TEST = DS.split("train"), DS.split("test")


def slope_and_difference(loss, at: np.ndarray, step: float = 1e-4) -> tuple[float, float]:
    """The derivative of a loss along a random direction, by JAX and by differences of fourth order."""
    direction = np.random.default_rng(3).normal(size=at.shape)
    slope = float(jnp.sum(jax.grad(loss)(jnp.asarray(at)) * direction))

    def quotient(h: float) -> float:
        return (float(loss(jnp.asarray(at + h * direction))) - float(loss(jnp.asarray(at - h * direction)))) / (2 * h)

    return slope, (4 * quotient(step) - quotient(2 * step)) / 3


def of_error(found: jax.Array, wanted: np.ndarray) -> jax.Array:
    return jnp.sum((found - wanted) ** 2) / np.sum(np.asarray(wanted) ** 2)


def test_the_chain_is_the_bake_where_nothing_is_moved():
    """In a convex room without shadows; float32 rounding of the bake is all that differs."""
    assert np.asarray(measured_light(TEST, TEST.lightings)) == pytest.approx(TEST.measured, rel=1e-5)
    direct = direct_light(DS.transport.samples, TEST.lightings)
    albedo = jnp.asarray(DS.transport.samples.albedo)
    assert np.asarray(indirect_light(DS.transport, direct, albedo)) == pytest.approx(TEST.indirect, rel=1e-4)


@pytest.mark.parametrize("name", ["position", "direction", "intensity", "cutoff"])
def test_gradients_of_lights_reach_the_prediction(name):
    """lights → measured light → prediction."""
    model = prt.method("svd-ridge", basis=8).fit(TRAIN)
    plain = {"position": [0.1, 0.2, -0.3], "direction": [0.3, -1.0, 0.2], "intensity": [2.0, 1.0, 0.5], "cutoff": 1.2}

    def loss(value):
        light = SpotLight(**{**{key: jnp.asarray(part) for key, part in plain.items()}, name: value})
        x = measured_light(DS, [Lighting((light,))])
        return of_error(model.reconstruct(model.transfer(x)), TEST.indirect[:1])

    slope, wanted = slope_and_difference(loss, np.asarray(plain[name], float))
    assert abs(wanted) > 1e-4
    assert slope == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("of", ["albedo", "direct"])
def test_gradients_reach_through_all_bounces(of):
    """albedo, direct light → operator → indirect light."""
    direct = np.asarray(direct_light(DS.transport.samples, TEST.lightings[:3]))
    albedo = np.asarray(DS.transport.samples.albedo, float)

    def loss(value):
        light, colour = (value, albedo) if of == "direct" else (direct, value)
        return of_error(indirect_light(DS.transport, jnp.asarray(light), jnp.asarray(colour)), TEST.indirect[3:6])

    slope, wanted = slope_and_difference(loss, direct if of == "direct" else albedo)
    assert slope == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("label", ["svd-ridge", "operator-ridge", "streamed-ridge"])
def test_gradients_of_a_ridge_reach_the_error_of_the_fit(label):
    """dataset → fit → error, in a setting that JAX traces."""

    def loss(factor):
        return of_error(prt.method(label, basis=8).with_traced(ridge=factor).fit(TRAIN).predict(TEST), TEST.indirect)

    slope, wanted = slope_and_difference(loss, np.asarray(0.02), 1e-4)
    assert slope == pytest.approx(wanted, rel=1e-5)


def test_gradients_of_a_mixture_weight_reach_the_error_of_the_fit():
    method = prt.method("operator-ridge", basis=8, ridge=0.03)

    def loss(share):
        return of_error(method.with_traced(prior=share).fit(TRAIN).predict(TEST), TEST.indirect)

    slope, wanted = slope_and_difference(loss, np.asarray(0.3), 1e-4)
    assert slope == pytest.approx(wanted, rel=1e-5)


def test_gradients_of_measurement_weights_reach_the_error_of_the_fit():
    """Each measured value times a weight of its own, in training and at test: a ridge then trusts it more or less."""

    def loss(weight):
        lit = [SimpleNamespace(**observed(part), measured=part.measured * weight[:, None]) for part in (TRAIN, TEST)]
        return of_error(prt.method("svd-ridge", basis=8, ridge=0.05).fit(lit[0]).predict(lit[1]), TEST.indirect)

    def observed(part):
        return {"indirect": part.indirect, "indirect_half": part.indirect, "lightings": part.lightings}

    slope, wanted = slope_and_difference(loss, np.linspace(0.5, 1.5, TRAIN.measured.shape[1]), 1e-4)
    assert abs(wanted) > 1e-6
    assert slope == pytest.approx(wanted, rel=1e-5)


def test_the_mixture_weight_is_finite_at_its_ends():
    lightings, prior = (
        (jnp.asarray(a), jnp.asarray(b)) for a, b in zip(np.ones((2, 3, 4)), np.ones((2, 2, 4)), strict=True)
    )
    for share in (0.0, 1.0):
        slope = jax.grad(lambda s: jnp.sum(mixed(lightings, prior, s)[0]))(share)
        assert np.isfinite(slope)


def test_visibility_is_that_of_the_bakes_shadow_rays():
    """Weighted with it, the differentiable irradiance is the traced one."""
    scene = prt.load_scene("cornell")
    tracer = Tracer(scene)
    lightings = [
        Lighting((PointLight((0.5, 1.6, 0.6), (1.0, 2.0, 3.0)),)),
        Lighting((PointLight((-0.7, 0.3, 0.5), (1, 1, 1)),)),
    ]
    points = DS.transport.samples  # of another room, which cross this one: some lie in the shadow of its blocks
    seen = visibility(tracer, points, emitters(lightings))
    assert 0.02 < np.mean(seen) < 0.98
    found = np.asarray(direct_light(points, lightings, seen))
    assert found == pytest.approx(direct_irradiance(tracer, points, emitters(lightings)), rel=1e-4, abs=1e-6)
    assert np.sum(found) < 0.98 * np.sum(np.asarray(direct_light(points, lightings)))


def test_settings_that_a_method_lacks_are_refused():
    with pytest.raises(SpecError, match="no setting 'prior'"):
        prt.method("svd-ridge").with_traced(prior=jnp.asarray(0.5))
