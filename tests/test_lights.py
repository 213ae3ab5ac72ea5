"""Lights against closed forms, finite differences and second derivations."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad

import prt_bench as prt
from prt_bench.environment import EnvironmentMap, median_cut, texel_directions
from prt_bench.errors import LightError
from prt_bench.lights import emitters, irradiance, light_from_json, rotation_matrix, turned

LIGHTS = [
    prt.PointLight([0.3, 1.0, -0.2], [3.0, 2.0, 1.0]),
    prt.SpotLight([0.2, 1.5, 0.1], [0.1, -1.0, 0.0], [4.0, 4.0, 5.0], 0.6, 0.4),
    prt.DirectionalLight([0.2, -1.0, 0.3], [1.0, 2.0, 3.0]),
    prt.SphereLight([0.1, 1.2, 0.0], 0.2, [5.0, 4.0, 3.0]),
    prt.RectLight([0.0, 1.4, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.4], [2.0, 2.0, 2.0]),
    prt.EnvironmentLight(np.random.default_rng(0).random((16, 32, 3)) ** 4, [0.1, 0.7, -0.3]),
]
ORIGIN, UP = jnp.zeros((1, 3)), jnp.array([[0.0, 1.0, 0.0]])


def at_origin(light: prt.PointLight) -> np.ndarray:
    return np.asarray(irradiance(light.emitters(), ORIGIN, UP)[0])


def test_point_light_follows_the_inverse_square_law() -> None:
    light = prt.PointLight([0.0, 2.0, 0.0], [8.0, 4.0, 2.0], radius=0.0)
    np.testing.assert_allclose(at_origin(light), [2.0, 1.0, 0.5], rtol=1e-12)
    tilted = prt.PointLight([1.0, 1.0, 0.0], [8.0, 4.0, 2.0], radius=0.0)
    np.testing.assert_allclose(at_origin(tilted), np.array([8.0, 4.0, 2.0]) / 2.0 * np.sqrt(0.5), rtol=1e-12)


def test_light_behind_the_surface_causes_nothing() -> None:
    assert np.all(at_origin(prt.PointLight([0.0, -1.0, 0.0], [1.0, 1.0, 1.0])) == 0)
    assert np.all(at_origin(prt.DirectionalLight([0.0, 1.0, 0.0], [1.0, 1.0, 1.0])) == 0)


def test_contact_with_a_light_is_bounded_and_has_a_finite_gradient() -> None:
    def total(position: jax.Array) -> jax.Array:
        light = prt.PointLight(position, jnp.ones(3), radius=0.01)
        return irradiance(light.emitters(), ORIGIN, UP).sum()

    for height in (0.0, 1e-12, 1e-6):
        place = jnp.array([0.0, height, 0.0])
        assert total(place) <= 3.0 / 0.01**2
        assert np.all(np.isfinite(jax.grad(total)(place)))


def test_spot_light_is_full_inside_and_zero_outside_its_cone() -> None:
    def under(angle: float) -> float:
        direction = [np.sin(angle), -np.cos(angle), 0.0]
        return float(at_origin(prt.SpotLight([0.0, 1.0, 0.0], direction, [1.0, 1.0, 1.0], 0.5, 0.4, 0.0))[0])

    assert under(0.29) == pytest.approx(1.0)
    assert under(0.51) == 0.0
    edge = [under(angle) for angle in np.linspace(0.3, 0.5, 9)]
    assert all(a > b for a, b in itertools.pairwise(edge))


def test_sphere_light_matches_the_solid_angle_formula_far_away() -> None:
    # E = π L (r / d)² for a sphere overhead.
    light = prt.SphereLight([0.0, 5.0, 0.0], 0.2, [3.0, 3.0, 3.0])
    np.testing.assert_allclose(at_origin(light), np.pi * 3.0 * (0.2 / 5.0) ** 2, rtol=0.02)


def test_rect_light_matches_a_quadrature_of_the_form_factor() -> None:
    light = prt.RectLight([0.1, 1.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, -0.2], [1.0, 1.0, 1.0])
    if float(light.emitters().axis[0, 1]) > 0:
        light = prt.RectLight([0.1, 1.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.2], [1.0, 1.0, 1.0])
    exact, _ = dblquad(lambda z, x: 1.0 / (x * x + 1.0 + z * z) ** 2, -0.2, 0.4, -0.2, 0.2)
    np.testing.assert_allclose(at_origin(light)[0], exact, rtol=0.02)


def test_median_cut_keeps_vector_irradiance_and_points_at_the_sun() -> None:
    radiance = np.full((32, 64, 3), 0.1, np.float32)
    radiance[8, 40] = 1e5
    environment = EnvironmentMap("sun", radiance)
    direction, energy = median_cut(environment, 64)
    _, solid_angle = texel_directions(32, 64)
    exact = np.einsum("hwd,hw->d", texel_directions(32, 64)[0], radiance[..., 0] * solid_angle)
    np.testing.assert_allclose(direction.T @ energy[:, 0], exact, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, rtol=1e-12)
    sun = texel_directions(32, 64)[0][8, 40]
    assert np.max(direction[energy[:, 0].argmax()] @ sun) > 0.999


def test_solid_angles_fill_the_sphere() -> None:
    _, solid_angle = texel_directions(16, 32)
    assert float(solid_angle.sum() * 32) == pytest.approx(4 * np.pi, rel=1e-12)


def test_uniform_environment_gives_pi_times_its_radiance() -> None:
    light = prt.EnvironmentLight(np.full((64, 128, 3), 2.0))
    np.testing.assert_allclose(at_origin(light), 2.0 * np.pi, rtol=0.005)


def test_rotation_turns_the_environment() -> None:
    radiance = np.zeros((32, 64, 3), np.float32)
    radiance[16, 32] = 1.0  # straight ahead, −z
    turned = prt.EnvironmentLight(radiance, [0.0, np.pi / 2, 0.0]).emitters()
    brightest = np.asarray(turned.intensity).sum(1).argmax()
    np.testing.assert_allclose(np.asarray(turned.position)[brightest, :3], [-1.0, 0.0, 0.0], atol=0.06)


def test_rotation_matrix_is_orthogonal_and_smooth_at_zero() -> None:
    matrix = rotation_matrix(jnp.array([0.3, -0.2, 0.9]))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.all(np.isfinite(jax.jacobian(rotation_matrix)(jnp.zeros(3))))


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_gradients_of_every_parameter_match_finite_differences(light: prt.PointLight) -> None:
    points = jnp.asarray(np.random.default_rng(1).uniform(-0.3, 0.3, (5, 3)))
    normals = jnp.tile(UP, (5, 1))
    weight = jnp.asarray(np.random.default_rng(2).random((5, 3)))

    leaves, tree = jax.tree.flatten(light)

    @jax.jit
    def loss(leaves: list[jax.Array]) -> jax.Array:
        return jnp.sum(weight * irradiance(jax.tree.unflatten(tree, leaves).emitters(), points, normals))

    gradient = jax.grad(loss)([jnp.asarray(leaf, float) for leaf in leaves])
    for i, leaf in enumerate(leaves):
        flat = np.asarray(leaf, float).ravel()
        for j in range(flat.size):
            step = 1e-6 * max(1.0, abs(flat[j]))
            ends = []
            for sign in (1, -1):
                moved = flat.copy()
                moved[j] += sign * step
                changed = [*leaves[:i], jnp.asarray(moved.reshape(np.shape(leaf))), *leaves[i + 1 :]]
                ends.append(float(loss(changed)))
            numeric = (ends[0] - ends[1]) / (2 * step)
            assert float(gradient[i].ravel()[j]) == pytest.approx(numeric, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_lights_survive_json(light: prt.PointLight) -> None:
    maps = {light.map.hash: light.map} if isinstance(light, prt.EnvironmentLight) else {}
    again = light_from_json(light.to_json(), maps)
    for a, b in zip(jax.tree.leaves(light.emitters()), jax.tree.leaves(again.emitters()), strict=True):
        np.testing.assert_array_equal(a, b)


def test_batches_pad_with_darkness_and_an_empty_lighting_is_black() -> None:
    batch = emitters([prt.Lighting(()), prt.Lighting(tuple(LIGHTS[:3])), prt.Lighting(tuple(LIGHTS[3:4]))])
    assert batch.position.shape == (3, 16, 4)
    for index, expected in ((0, 0.0), (1, sum(at_origin(light) for light in LIGHTS[:3])), (2, at_origin(LIGHTS[3]))):
        one = jax.tree.map(lambda leaf, i=index: leaf[i], batch)
        np.testing.assert_allclose(irradiance(one, ORIGIN, UP)[0], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("light", "word"),
    [
        (prt.PointLight([0, 0, 0], [-1.0, 0, 0]), "negative"),
        (prt.PointLight([np.nan, 0, 0], [1.0, 0, 0]), "finite"),
        (prt.SpotLight([0, 0, 0], [0.0, 0, 0], [1.0, 1, 1]), "zero vector"),
        (prt.SpotLight([0, 0, 0], [0.0, 1, 0], [1.0, 1, 1], 4.0), "cutoff"),
        (prt.SphereLight([0, 0, 0], 0.0, [1.0, 1, 1]), "above zero"),
        (prt.RectLight([0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [1.0, 1, 1]), "no area"),
    ],
)
def test_impossible_lights_are_refused(light: prt.PointLight, word: str) -> None:
    with pytest.raises(LightError, match=word):
        prt.Lighting((light,)).check()


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_environment_with_bad_pixels_is_refused_with_a_count(value: float) -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[1, 2, 0] = value
    with pytest.raises(LightError, match="1 negative or non-finite"):
        EnvironmentMap("bad", radiance)


def test_distant_light_turns_about_the_vertical_and_near_light_stays():
    lights = (
        prt.DirectionalLight((1.0, -1.0, 0.0), (1.0, 1.0, 1.0)),
        prt.EnvironmentLight(np.random.default_rng(0).random((8, 16, 3)), (0.3, 0.2, -0.1)),
        prt.PointLight((1.0, 2.0, 3.0), (1.0, 1.0, 1.0)),
    )
    whole = turned(prt.Lighting(lights), np.pi / 2)
    np.testing.assert_allclose(whole.lights[0].direction, (0.0, -1.0, -1.0), atol=1e-12)
    quarter = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    before, after = (rotation_matrix(lighting.lights[1].rotation) for lighting in (prt.Lighting(lights), whole))
    np.testing.assert_allclose(after, quarter @ before, atol=1e-12)
    assert whole.lights[2] is lights[2]
