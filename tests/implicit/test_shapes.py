"""Signed distances by their properties: slopes, differences, closed forms, refusals."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from prt_bench.errors import SceneError
from prt_bench.implicit.expression import distances, gradients, normals
from prt_bench.implicit.grid import GridDistance
from prt_bench.implicit.operations import SmoothUnion, Turned
from prt_bench.implicit.scene import ImplicitScene, Part
from prt_bench.implicit.shapes import Box, Gyroid, Mandelbulb, Plane, Sphere
from prt_bench.scene import Material

from .conftest import CAMERA, EXACT, SHAPES, alone

PLACES = np.random.default_rng(0).uniform(-1.2, 1.2, (1024, 3))
PLACES[0] = 0.0


@pytest.mark.parametrize("name", SHAPES)
def test_slopes_are_those_of_differences_and_within_their_bound(name):
    shape = SHAPES[name]
    found, slope = (np.asarray(f(shape, PLACES)) for f in (distances, gradients))
    assert np.all(np.isfinite(found))
    assert np.all(np.isfinite(slope))
    length = np.linalg.norm(slope, axis=1)
    outside = found > 1e-3
    assert length[outside].max() <= shape.slope * (1 + 1e-9)
    if name in EXACT:
        np.testing.assert_allclose(length[1:], 1.0, atol=1e-9)
    step = 1e-6
    ahead, behind = (np.asarray(distances(shape, PLACES + sign * step * slope)) for sign in (1, -1))
    gap = np.abs((ahead - behind) / (2 * step) - length**2) / np.maximum(length**2, 1)
    assert np.mean(gap < 1e-5) > 0.99, "everywhere but at creases"


def test_slopes_of_a_grid_are_continuous_and_its_spline_smooths_as_told():
    grid = SHAPES["grid"]
    walls = np.asarray(grid.low) + grid.cell * (np.array([[3, 4, 5], [10, 10, 14], [12, 9, 6]]) + 0.5)
    for axis in np.eye(3):
        one, other = (np.asarray(gradients(grid, walls + sign * 1e-7 * axis)) for sign in (-1, 1))
        np.testing.assert_allclose(one, other, atol=1e-5)
    place = np.asarray(grid.low) + grid.cell * np.array([[17.0, 12.0, 4.0], [5.3, 3.1, 14.8]])
    r = np.linalg.norm(place, axis=1)
    added = np.asarray(distances(grid, place)) - (r - 0.6)
    np.testing.assert_allclose(added, (2.0 / r) * grid.cell**2 / 8.0, rtol=0.03)


def test_a_normal_is_unit_where_there_is_no_slope():
    flat = normals(SHAPES["sphere"], PLACES[:1], 1e-3)
    np.testing.assert_allclose(flat, [[0, 1, 0]])


def test_parameters_have_derivatives():
    place = jnp.array([[0.3, 0.9, 0.1]])
    shape = SmoothUnion(Sphere(jnp.array(0.5)), Box(jnp.array([0.3, 0.3, 0.3])), jnp.array(0.4))
    slope = eqx.filter_jit(eqx.filter_grad(lambda shape: shape(place)[0]))(shape)
    step = 1e-6
    for pick in (lambda s: s.a.radius, lambda s: s.width):
        grown, shrunk = (float(distances(eqx.tree_at(pick, shape, replace_fn=lambda v, h=h: v + h), place)[0])
                         for h in (step, -step))  # fmt: skip
        assert float(pick(slope)) == pytest.approx((grown - shrunk) / (2 * step), abs=1e-7)
        assert float(pick(slope)) != 0


def test_distances_known_by_hand():
    box = Box((1.0, 2.0, 3.0))
    places = jnp.array([[2.0, 3.0, 3.0], [0.0, 0.0, 0.0], [0.5, 1.9, 0.0], [1.0, 2.0, 4.0]])
    np.testing.assert_allclose(distances(box, places), [2**0.5, -1.0, -0.1, 1.0], atol=1e-9)
    blend = SmoothUnion(Plane((1.0, 0.0, 0.0)), Plane((0.0, 1.0, 0.0)), 0.4)
    np.testing.assert_allclose(
        distances(blend, jnp.array([[0.3, 0.3, 0.0], [2.0, 0.1, 0.0]])), [0.3 - 0.1, 0.1], atol=1e-12
    )
    k = 2 * np.pi / 0.9
    p = PLACES[5]
    g = sum(np.sin(k * p[i]) * np.cos(k * p[(i + 1) % 3]) for i in range(3))
    found = distances(SHAPES["gyroid"], PLACES)[5]
    assert float(found) == pytest.approx((abs(g) - 0.4) / (3**0.5 * k))


def test_a_mandelbulb_follows_its_angles():
    """Against the formula with angles: r⁸ (sin 8θ cos 8φ, sin 8θ sin 8φ, cos 8θ) + c."""
    found = np.asarray(distances(Mandelbulb(2), PLACES))
    for place, wanted in zip(PLACES[1:50], found[1:50], strict=True):
        p, growth = place, 1.0
        for _ in range(2):
            r = np.linalg.norm(p)
            if r >= 2:
                break
            theta, phi = np.arccos(p[2] / r), np.arctan2(p[1], p[0])
            power = np.array(
                [np.sin(8 * theta) * np.cos(8 * phi), np.sin(8 * theta) * np.sin(8 * phi), np.cos(8 * theta)]
            )
            p, growth = r**8 * power + place, 8 * r**7 * growth + 1
        r = np.linalg.norm(p)
        assert wanted == pytest.approx(0.5 * np.log(r) * r / growth, rel=1e-9)


class Doubled(Sphere):
    """Twice the distance: rays would step through."""

    def __call__(self, place):
        return 2.0 * super().__call__(place)


def test_a_distance_that_is_too_steep_is_noticed():
    assert np.linalg.norm(np.asarray(gradients(Doubled(0.5), PLACES)), axis=1).max() > Doubled(0.5).slope


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Sphere(-1.0),
        lambda: Box((0.1, 0.1, 0.1), 0.2),
        lambda: Plane((0.0, 2.0, 0.0)),
        lambda: SmoothUnion(Sphere(1.0), Sphere(1.0), 0.0),
        lambda: Turned(Sphere(1.0), 2 * np.eye(3)),
        lambda: GridDistance(np.ones(27), (0, 0, 0), 0.1),
        lambda: GridDistance(np.ones(28), (0, 0, 0), 0.1),
        lambda: alone(Gyroid(0.5)),
        lambda: ImplicitScene("none", (), CAMERA),
        lambda: ImplicitScene("i", (Part(Sphere(1.0), Material("i", image=np.ones((2, 2, 3)))),), CAMERA),
    ],
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(SceneError):
        wrong()
