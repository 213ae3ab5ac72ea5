"""Glossy transfer against quadrature, the path tracer's formulas, and itself with the light fixed."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import prt_bench as prt
from prt_bench.example import example_dataset
from prt_bench.glossy import Surface, TripleModel, mirrored
from prt_bench.runtime.generate import matrix_entries, operations, pairs
from prt_bench.spherical import cosine_lobe, evaluate, product_matrix, quadrature

ORDER = 5


@pytest.fixture(scope="module")
def room():
    return example_dataset(texels=4, rays=64, walls=5)


def unit(count: int, seed: int = 0) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def light(channels: int = 3, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(2, ORDER**2, channels))


def test_lobes_read_off_the_product_of_light_and_transfer(room):
    """By quadrature of the projected product of both functions and the lobe, band by band; no tensor comes near."""
    model = prt.method("sh-triple").fit(room)
    mirror, exponent = unit(len(room.points)), np.full(len(room.points), 30.0)
    u = light()
    directions, weight = quadrature(4 * ORDER)
    y = np.asarray(evaluate(directions, ORDER))
    product = np.einsum("tk,qk->tq", model.basis[:, -1], y) * np.einsum("nkc,qk->ncq", u, y)[:, :, None]
    projected = np.einsum("nctq,q,qk->nctk", product, weight, y)
    # Factors of the lobe by its own integral with Legendre polynomials.
    nodes, gauss = np.polynomial.legendre.leggauss(400)
    cosine, gauss = 0.5 * (nodes + 1.0), 0.5 * gauss
    legendre = np.polynomial.legendre.legvander(cosine, ORDER - 1)
    factors = 31.0 * np.einsum("q,q,ql->l", gauss, cosine**30.0, legendre)
    lobe = np.asarray(evaluate(mirror, ORDER)) * np.repeat(factors, 2 * np.arange(ORDER) + 1)
    wanted = np.einsum("nctk,tk->ntc", projected, lobe)
    np.testing.assert_allclose(model.gloss(u, mirror, exponent), wanted, rtol=1e-8, atol=1e-8)


def test_light_that_is_fixed_gives_the_same(room):
    mirror, exponent = unit(len(room.points)), 10.0 ** np.linspace(0, 3, len(room.points))
    free, fixed = (
        prt.method(name).fit(room).gloss(light(), mirror, exponent) for name in ("sh-triple", "sh-triple-fixed")
    )
    np.testing.assert_allclose(fixed, free, rtol=1e-9, atol=1e-9)


def test_an_open_surface_under_even_light_reflects_the_cosine_seen_by_the_lobe():
    """Radiance 1 from everywhere: B = ∫ max(n·ω, 0) (s + 1)/2π max(ω·ω_r, 0)^s dω, to the bands there are."""
    normal = np.array([[0.0, 0.0, 1.0]])
    transfer = np.zeros((1, 1, 64))
    for band, factor in enumerate(cosine_lobe(8)):
        transfer[0, 0, band * (band + 1)] = factor * np.sqrt((2 * band + 1) / (4 * np.pi))
    model = TripleModel(jnp.asarray(transfer), jnp.zeros(3))
    sky = np.zeros((1, 64, 1))
    sky[0, 0] = np.sqrt(4.0 * np.pi)
    for tilt in (0.0, 0.5, 1.0):
        towards = np.array([[np.sin(tilt), 0.0, np.cos(tilt)]])
        mirror = np.asarray(mirrored(towards, normal))
        np.testing.assert_allclose(mirror, [[-np.sin(tilt), 0.0, np.cos(tilt)]], atol=1e-12)
        directions, weight = quadrature(120)
        lobe = 21.0 / (2 * np.pi) * np.maximum(directions @ mirror[0], 0.0) ** 20
        wanted = np.sum(weight * lobe * np.maximum(directions[:, 2], 0.0))
        found = float(model.gloss(sky, mirror, np.array([20.0]))[0, 0, 0])
        assert found == pytest.approx(wanted, abs=0.01)


@pytest.mark.parametrize("exponent", [0.0, 1e-3, 2.5, 1e6, np.inf])
def test_any_exponent_is_finite_with_its_derivative(room, exponent):
    model = prt.method("sh-triple").fit(room)
    mirror = unit(len(room.points))

    def loss(s: jax.Array) -> jax.Array:
        return jnp.sum(model.gloss(light(), mirror, jnp.full(len(mirror), s)))

    assert np.isfinite(loss(jnp.asarray(exponent)))
    assert np.isfinite(jax.grad(loss)(jnp.asarray(exponent)))


def test_radiance_adds_diffuse_light_and_the_lobe(room):
    model = prt.method("sh-triple").fit(room)
    points = room.points
    surface = Surface(points.normal, points.albedo, np.full((len(points), 3), 0.3), np.full(len(points), 12.0))
    towards = points.normal + 0.3 * unit(len(points))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    u = light()
    dull = model.radiance(u, surface._replace(specular=np.zeros((len(points), 3))), towards)
    np.testing.assert_allclose(dull, points.albedo / np.pi * np.asarray(model.reconstruct(u)), rtol=1e-12)
    added = np.asarray(model.radiance(u, surface, towards) - dull)
    wanted = 0.3 * np.maximum(model.gloss(u, mirrored(towards, points.normal), surface.exponent), 0.0)
    np.testing.assert_allclose(added, wanted, atol=1e-10)
    assert (added > 0).any()
    assert (added >= 0).all()


def test_one_vector_serves_both_without_interreflection(room):
    alone = prt.method("sh-triple", interreflection=False).fit(room)
    both = prt.method("sh-triple").fit(room)
    assert alone.basis.shape[1:] == (1, 25)
    assert both.basis.shape[1:] == (4, 25)
    np.testing.assert_array_equal(alone.basis[:, 0], both.basis[:, -1])
    texture = prt.method("sh-texture").fit(room)
    np.testing.assert_allclose(both.reconstruct(light()), texture.reconstruct(light()), rtol=1e-12)


def test_the_generated_product_needs_a_twentieth_of_the_arithmetic():
    found = operations(5)
    assert found["dense"] == 3 * 25**3
    assert found["sparse"] < found["dense"] / 20
    for order in (2, 3, 4, 6):
        assert operations(order)["sparse"] <= operations(order)["dense"] / 5


def test_rows_of_the_matrix_are_the_products_with_the_light():
    starts, indices, values = matrix_entries(4)
    coefficients = np.random.default_rng(0).normal(size=16)
    whole = np.asarray(product_matrix(coefficients))
    for row, (i, k) in enumerate(pairs(4)):
        part = slice(starts[row], starts[row + 1])
        assert np.dot(values[part], coefficients[indices[part]]) == pytest.approx(whole[i, k], abs=1e-12)
    left = np.ones((16, 16), bool)
    left[tuple(np.array(pairs(4)).T)] = False
    assert np.abs(whole[np.triu(left)]).max() < 1e-12


def test_scenes_without_lobes_are_what_diffuse_transfer_shows(room):
    found = prt.evaluate(prt.method("sh-triple").fit(room), room.split("test")).errors
    diffuse = prt.evaluate(prt.method("sh-texture").fit(room), room.split("test")).errors
    assert found.relative_rmse == pytest.approx(diffuse.relative_rmse, rel=1e-5)
    assert replace(found, storage=None).total == pytest.approx(diffuse.total, rel=1e-5)
