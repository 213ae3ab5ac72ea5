"""Compressed hemispheres of depth against a ball whose shadow has a closed form."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from prt_bench.depth import ClusteredVisibility, DirectionGrid, hemisphere_directions, shadow_error
from prt_bench.errors import FitError
from prt_bench.hemisphere import tangent_frames
from prt_bench.points import SurfacePoints

BALL, RADIUS = np.array([0.1, -0.2, 1.0]), 0.4
LIGHTS = np.array([[0.3, 0.2, 2.5], [-0.8, -0.5, 2.0], [0.4, 0.9, 0.7], [0.0, 0.0, -1.0]])
NEAR = 0.25


def ground(side: int = 16) -> SurfacePoints:
    x, y = np.meshgrid(*[np.linspace(-1.5, 1.5, side)] * 2)
    position = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    return SurfacePoints(
        position, np.tile([0.0, 0.0, 1.0], (side**2, 1)), 0 * position, np.zeros(side**2, int), 0 * position
    )


def to_ball(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distance along unit directions, inf past the ball."""
    away = BALL - origin
    along = np.sum(away * direction, axis=-1)
    left = RADIUS**2 - np.sum(away**2, axis=-1) + along**2
    return np.where((left > 0) & (along > 0), along - np.sqrt(np.maximum(left, 0.0)), np.inf)


def buffers(points: SurfacePoints, directions: np.ndarray) -> np.ndarray:
    world = np.einsum("kd,pdx->pkx", directions, tangent_frames(points.normal, np.zeros(len(points))))
    return to_ball(points.position[:, None], world)


def wanted(points: SurfacePoints) -> np.ndarray:
    away = LIGHTS[:, None] - points.position
    distance = np.linalg.norm(away, axis=-1)
    return (to_ball(points.position, away / distance[..., None]) > distance) & (away[..., 2] > 0)


def fitted(points: SurfacePoints, count: int, size: int) -> ClusteredVisibility:
    directions = hemisphere_directions(count)
    owner = (points.position[:, 0] > 0).astype(int)
    return ClusteredVisibility.fit(buffers(points, directions), directions, owner, size, NEAR)


def error(found: np.ndarray, points: SurfacePoints) -> float:
    return shadow_error(found, wanted(points), np.ones(found.shape))


def test_directions_share_the_hemisphere_evenly():
    directions = hemisphere_directions(2000)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    second = np.diag([1 / 3] * 3)
    np.testing.assert_allclose(directions.T @ directions / 2000, second, atol=2e-3)
    np.testing.assert_allclose(directions.mean(axis=0), (0, 0, 0.5), atol=2e-3)


@pytest.mark.parametrize("count", [4, 126, 504])
def test_cells_know_the_four_nearest_directions_of_every_place_in_them(count):
    directions = hemisphere_directions(count)
    grid = DirectionGrid.of(directions)
    towards = np.random.default_rng(count).normal(size=(4000, 3))
    towards[2000:, 2] *= 0.02  # near the horizon
    towards[:, 2] = np.abs(towards[:, 2])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    place = towards[:, :2] / np.sqrt(1.0 + towards[:, 2:])
    column, row = np.minimum((0.5 * place + 0.5) * grid.side, grid.side - 1).astype(int).T
    cell = row * grid.side + column
    nearest = np.asarray(KDTree(directions).query(towards, k=4)[1])
    for at, wanted in zip(cell, nearest, strict=True):
        assert set(wanted) <= set(grid.candidates[grid.starts[at] : grid.starts[at + 1]])
    assert np.diff(grid.starts).max() < 20


def test_sixteen_bits_hold_the_buffers():
    points = ground(8)
    model = fitted(points, 100, 12)
    stored = model.quantised()
    off = stored.stored(np.arange(64), np.tile(np.arange(100), (64, 1)))
    off = off - model.stored(np.arange(64), np.tile(np.arange(100), (64, 1)))
    assert 0 < np.abs(off).max() < 1e-3
    coefficients, functions = model.packed(0.25)
    kept = len(coefficients.values) + len(functions.values)
    assert kept == round(0.25 * (model.coefficients.size + model.basis.size))


def test_with_every_component_buffers_come_back_escaped_rays_too():
    points = ground(6)
    model = fitted(points, 100, 36)
    depth = buffers(points, model.directions)
    assert np.isinf(depth).any()
    assert np.isfinite(depth).any()
    found = model.stored(np.arange(36), np.tile(np.arange(100), (36, 1)))
    np.testing.assert_allclose(found, np.where(np.isinf(depth), 0.0, 1.0 / (depth + NEAR)), atol=1e-6)


def test_shadows_of_a_ball_sharpen_with_directions_and_coefficients():
    points = ground()
    fine, coarse = fitted(points, 2000, 128), fitted(points, 50, 128)
    errors = [error(fine.truncated(size).lit(points, LIGHTS), points) for size in (2, 20, 128)]
    assert errors[0] > 1.5 * errors[1] > 1.5 * errors[2]
    assert errors[2] < 0.12
    assert error(coarse.lit(points, LIGHTS), points) > 1.5 * errors[2]
    everything_lit = np.broadcast_to(LIGHTS[:, 2:] > 0, (4, len(points.position)))
    assert errors[1] < 0.7 * error(everything_lit.astype(float), points)


def test_a_light_below_the_horizon_is_not_seen():
    points = ground(6)
    assert not fitted(points, 100, 10).lit(points, LIGHTS)[3].any()


def test_light_in_front_of_an_occluder_is_seen():
    """A lamp between the ground and the ball, whose direction is the same as that of one behind it."""
    points = ground(5)
    centre = np.array([0.1, -0.2])
    below = np.argmin(np.linalg.norm(points.position[:, :2] - centre, axis=1))
    towards = BALL - points.position[below]
    towards /= np.linalg.norm(towards)
    lamps = points.position[below] + np.array([[0.3], [2.0]]) * towards
    seen = fitted(points, 500, 25).lit(points, lamps)[:, below]
    np.testing.assert_allclose(seen, (1.0, 0.0), atol=1e-9)


def test_bad_buffers_are_refused():
    directions, owner = hemisphere_directions(4), np.zeros(3, int)
    with pytest.raises(FitError, match="NaN"):
        ClusteredVisibility.fit(np.full((3, 4), np.nan), directions, owner, 2, NEAR)
    with pytest.raises(FitError, match="positive"):
        ClusteredVisibility.fit(np.ones((3, 4)), directions, owner, 0, NEAR)
