"""Properties of lights, the operator and fits over random inputs: what must hold for any light whatever."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import prt_bench as prt
from prt_bench.emitters import irradiance
from prt_bench.stability.rigs import LIGHTINGS, dataset, mixed, room
from prt_bench.transport import GatherOperator, indirect

some = partial(settings, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
factors = st.floats(1e-6, 1e6)
coordinates = st.floats(-5, 5, width=32)
triples = st.tuples(coordinates, coordinates, coordinates)
colours = st.tuples(*[st.floats(0, 1e4, width=32)] * 3)

RNG = np.random.default_rng(0)
POINTS = jnp.asarray(RNG.uniform(-1, 1, (6, 3)))
NORMALS = jnp.asarray((lambda n: n / np.linalg.norm(n, axis=1, keepdims=True))(RNG.normal(size=(6, 3))))


def directions(vector):
    return np.linalg.norm(vector) > 1e-3


lights = st.one_of(
    st.builds(prt.PointLight, triples, colours, st.floats(0, 1)),
    st.builds(prt.DirectionalLight, triples.filter(directions), colours),
    st.builds(
        prt.SpotLight, triples, triples.filter(directions), colours, st.floats(0.1, 3), st.floats(0.05, 1),
        st.floats(0, 1),
    ),
    st.builds(prt.SphereLight, triples, st.floats(0.01, 1), colours),
)  # fmt: skip


def lit(emitters):
    return np.asarray(irradiance(emitters, POINTS, NORMALS))


@some(max_examples=15)
@given(lights, lights, factors)
def test_light_is_never_negative_adds_up_and_scales(first, second, factor):
    """Non-negativity, additivity and homogeneity of irradiance."""
    a, b = first.emitters(), second.emitters()
    both = jax.tree.map(lambda *parts: jnp.concatenate(parts), a, b)
    brighter = type(a)(a.position, a.axis, factor * a.intensity, a.profile)
    first.check()
    assert lit(a).min() >= 0
    assert np.all(np.isfinite(lit(a)))
    np.testing.assert_allclose(lit(both), lit(a) + lit(b), rtol=1e-12)
    np.testing.assert_allclose(lit(brighter), factor * lit(a), rtol=1e-12)


@st.composite
def enclosures(draw):
    """Hits [20, 8], albedo and direct light of a scene that may leak."""
    rng = np.random.default_rng(draw(seeds))
    leak, most = draw(st.floats(0, 1)), draw(st.floats(0, 0.97))
    hits = np.where(rng.random((20, 8)) < leak, 20, rng.integers(0, 20, (20, 8)))
    return hits, jnp.asarray(rng.uniform(0, most, (20, 1))), jnp.asarray(rng.random((2, 20, 1)))


@some(max_examples=25)
@given(enclosures())
def test_bounces_conserve_energy_and_solve_the_rendering_equation(enclosure):
    """Rows sum to at most one; the series is the direct solve; no light is above the geometric series of the albedo."""
    hits, albedo, direct = enclosure
    gather = GatherOperator.from_hits(hits, 20)
    assert float(gather(jnp.ones((20, 1))).max()) <= 1 + 1e-15
    found = np.asarray(indirect(gather, albedo, direct, 900))[:, :, 0]
    matrix = np.asarray(gather(jnp.eye(20))) * np.asarray(albedo)[:, 0]
    light = np.asarray(direct)[:, :, 0].T
    np.testing.assert_allclose(found, np.linalg.solve(np.eye(20) - matrix, matrix @ light).T, rtol=1e-9, atol=1e-12)
    most = float(albedo.max())
    assert 0 <= found.min() <= found.max() <= most / (1 - most) * float(direct.max()) * (1 + 1e-9)


@some(max_examples=20)
@given(seeds)
def test_equal_patches_exchange_as_much_as_they_receive(seed):
    """Reciprocity: with hits that are symmetric in pairs, G is symmetric, and ⟨a, G b⟩ = ⟨G a, b⟩ for any light."""
    rng = np.random.default_rng(seed)
    partners = [rng.permutation(20) for _ in range(4)]
    hits = np.stack([table for p in partners for table in (p, np.argsort(p))], axis=1)
    gather = GatherOperator.from_hits(hits, 20)
    a, b = rng.random((2, 20, 1))
    assert float(jnp.vdot(a, gather(b))) == pytest.approx(float(jnp.vdot(gather(a), b)), rel=1e-12)


def mixtures(seed):
    rng = np.random.default_rng(seed)
    return mixed(rng.uniform(0, 1, (LIGHTINGS, LIGHTINGS - 1, 3)) ** 4)


METHODS = {
    name: prt.method(name, **settings)
    for name, settings in (
        ("svd-ridge", {"basis": 6}), ("operator-ridge", {"basis": 6}), ("mean", {}), ("nearest", {}), ("constant", {}),
    )
}  # fmt: skip
LINEAR = {
    "svd-ridge without mean": prt.method("svd-ridge", basis=6, mean=False),
    "operator-ridge": METHODS["operator-ridge"],
}


def fitted(method, seed):
    return method.fit(dataset(*mixtures(seed)))


def answer(model, x):
    return np.asarray(model.reconstruct(model.transfer(jnp.asarray(x))))


@pytest.mark.parametrize("name", METHODS)
@some(max_examples=5)
@given(seed=st.integers(0, 50), factor=factors)
def test_fits_are_homogeneous_and_deterministic(name, seed, factor):
    """f(a x) = a f(x), and the same data give the same bits."""
    model, again = fitted(METHODS[name], seed), fitted(METHODS[name], seed)
    x = room().split("test").measured.astype(float)
    plain = answer(model, x)
    np.testing.assert_array_equal(answer(again, x), plain)
    np.testing.assert_allclose(answer(model, factor * x), factor * plain, rtol=1e-9, atol=1e-12 * factor)


@pytest.mark.parametrize("name", LINEAR)
@some(max_examples=5)
@given(seed=st.integers(0, 50), a=factors, b=factors)
def test_mean_free_fits_add_up(name, seed, a, b):
    """f(a x + b y) = a f(x) + b f(y)."""
    model = fitted(LINEAR[name], seed)
    x, y = np.array_split(room().split("test").measured.astype(float), 2)
    together, apart = answer(model, a * x + b * y), a * answer(model, x) + b * answer(model, y)
    np.testing.assert_allclose(together, apart, atol=1e-10 * np.abs(apart).max())


@pytest.mark.parametrize("name", METHODS)
@some(max_examples=4)
@given(seed=st.integers(0, 50), order=st.permutations(range(LIGHTINGS)))
def test_the_order_of_training_lightings_does_not_matter(name, seed, order):
    measured, light = mixtures(seed)
    plain = METHODS[name].fit(dataset(measured, light))
    shuffled = METHODS[name].fit(dataset(measured[list(order)], light[list(order)]))
    x = room().split("test").measured.astype(float)
    np.testing.assert_allclose(answer(shuffled, x), answer(plain, x), atol=1e-9 * np.abs(answer(plain, x)).max())
