"""Lights and maps as coefficients: against integrals, with exact solid angles, at any brightness."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.environment import texel_directions
from prt_bench.errors import SpecError
from prt_bench.spherical import (
    cap_light,
    cap_solid_angle,
    convolve,
    cosine_lobe,
    count,
    delta_light,
    evaluate,
    project_environment,
    quadrature,
    reconstruct,
)


def by_quadrature(sky, order):
    """∫ over every texel by 20 × 20 Gauss–Legendre points in the angles: no separation, no turning."""
    height, width = sky.shape[:2]
    nodes, weight = np.polynomial.legendre.leggauss(20)
    theta = (np.arange(height)[:, None] + 0.5 + 0.5 * nodes) * np.pi / height
    phi = ((np.arange(width)[:, None] + 0.5 + 0.5 * nodes) / width * 2 - 1) * np.pi
    t, p = theta[:, None, :, None], phi[None, :, None, :]
    direction = np.stack(np.broadcast_arrays(np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)), axis=-1)
    area = np.sin(t) * weight[:, None] * weight * (np.pi / height / 2) * (np.pi / width)
    return np.einsum("hwabk,hwab,hwc->kc", evaluate(direction, order), np.broadcast_to(area, direction.shape[:-1]), sky)


@pytest.mark.parametrize("shape", [(4, 8), (5, 7), (8, 3)])
@pytest.mark.parametrize("order", [1, 5, 10])
def test_maps_are_integrated_over_their_texels(shape, order):
    sky = np.random.default_rng(0).random((*shape, 3))
    np.testing.assert_allclose(project_environment(sky, order), by_quadrature(sky, order), atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (1, 64), (3, 2), (64, 128)])
def test_a_constant_map_is_the_mean_alone(shape):
    found = project_environment(np.full((*shape, 3), 2.5), 10)
    wanted = np.zeros((100, 3))
    wanted[0] = 2.5 * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(found, wanted, atol=1e-13)


def test_a_map_that_is_a_harmonic_has_one_coefficient():
    """To the second order of the texel, because the map is constant in each: four times less at twice the size."""
    errors = []
    for height in (32, 64):
        direction, _ = texel_directions(height, 2 * height)
        found = project_environment(np.asarray(evaluate(direction, 4))[..., [1, 7, 14]], 4)
        wanted = np.eye(16)[:, [1, 7, 14]]
        errors.append(np.abs(np.asarray(found) - wanted).max())
    assert errors[0] < 0.01
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_a_map_and_a_delta_light_agree_on_where_things_are():
    """One texel, far from any symmetry, against the direction of its centre."""
    sky = np.zeros((64, 128, 1))
    sky[11, 90] = 3.0
    direction, solid_angle = texel_directions(64, 128)
    found = project_environment(sky, 4)
    np.testing.assert_allclose(found, delta_light(direction[11, 90], 3.0 * solid_angle[11], 4), rtol=5e-3, atol=1e-5)


def test_a_sun_of_one_texel_does_not_drown_the_sky():
    """Linear to rounding: the sky under a sun of 1e5 has the coefficients that both have alone."""
    rng = np.random.default_rng(1)
    sky, sun = rng.random((32, 64, 3)), np.zeros((32, 64, 3))
    sun[5, 20] = 1e5
    together = project_environment((sky + sun).astype(np.float32), 5)
    apart = project_environment(sky, 5) + project_environment(sun, 5)
    np.testing.assert_allclose(together, apart, atol=1e-6)
    solid_angle = texel_directions(32, 64)[1]
    energy = np.sum((sky + sun).astype(np.float32).astype(float) * solid_angle[..., None], axis=(0, 1))
    np.testing.assert_allclose(together[0], energy / np.sqrt(4 * np.pi), rtol=1e-13)


def test_maps_are_differentiable():
    sky = jnp.asarray(np.random.default_rng(0).random((4, 8, 1)))
    slope = jax.grad(lambda s: project_environment(s, 3)[4, 0])(sky)
    moved = project_environment(sky + slope, 3)[4, 0] - project_environment(sky, 3)[4, 0]
    assert float(moved) == pytest.approx(float(jnp.sum(slope**2)))


def test_a_cap_is_its_integral(directions):
    """By brute force over the sphere, about any direction; a narrow one is a delta light of the same irradiance."""
    points, weight = quadrature(600)
    towards = np.array([0.48, 0.6, 0.64])
    inside = (points @ towards >= np.cos(0.7)) * weight
    wanted = np.asarray(evaluate(points, 4)).T @ inside
    np.testing.assert_allclose(cap_light(towards, 0.7, np.ones(1), 4)[:, 0], wanted, atol=3e-3)
    narrow = cap_light(towards, 1e-4, np.ones(1), 4)
    np.testing.assert_allclose(narrow, delta_light(towards, np.asarray(cap_solid_angle(1e-4))[None], 4), rtol=1e-6)


def test_irradiance_of_a_cap_straight_above_is_the_closed_form():
    """π sin²α of a disc that fills the half-angle α, to the error of twelve bands."""
    light = cap_light(np.array([0.0, 0.0, 1.0]), 0.5, np.ones(1), 12)
    found = reconstruct(convolve(light, cosine_lobe(12), axis=0), np.array([0.0, 0.0, 1.0]))
    assert float(found[0]) == pytest.approx(np.pi * np.sin(0.5) ** 2, rel=5e-3)


def test_lights_come_in_batches(directions):
    values = np.random.default_rng(0).random((len(directions), 3))
    together = delta_light(directions, values, 3)
    assert together.shape == (len(directions), 9, 3)
    np.testing.assert_allclose(together[7], delta_light(directions[7], values[7], 3))
    caps = cap_light(directions, np.full(len(directions), 0.3), values, 3)
    np.testing.assert_allclose(caps[7], cap_light(directions[7], 0.3, values[7], 3))


def test_projection_and_reconstruction_are_inverse_on_their_span(directions):
    coefficients = np.random.default_rng(0).normal(size=(count(5), 2))
    points, weight = quadrature(8)
    values = np.asarray(reconstruct(coefficients, points))
    np.testing.assert_allclose(
        np.sum(delta_light(points, values * weight[:, None], 5), axis=0), coefficients, atol=1e-13
    )


def test_what_is_no_map_is_refused():
    with pytest.raises(SpecError, match=r"must be \[height, width, channels\]"):
        project_environment(np.ones((4, 8)), 3)
