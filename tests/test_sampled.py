"""Light at samples: the transfer between clusters against dense matrices, direct light against the inverse square."""

import numpy as np
import pytest

from prt_bench.depth import ClusteredVisibility, hemisphere_directions
from prt_bench.errors import FitError, LightError
from prt_bench.lights import DirectionalLight, Lighting, PointLight
from prt_bench.points import SurfacePoints
from prt_bench.sampled import ClusteredTransfer, SampledLight, reaches

RNG = np.random.default_rng(0)
SAMPLES, CLUSTERS, CHANNELS = 36, 3, 3
OWNER = RNG.permutation(np.repeat(np.arange(CLUSTERS), SAMPLES // CLUSTERS))
OPERATOR = RNG.random((CHANNELS, SAMPLES, SAMPLES)) / SAMPLES
LIGHT = RNG.random((SAMPLES, 60))
DIRECT = RNG.random((SAMPLES, CHANNELS))
CAUSED = np.einsum("cst,tc->sc", OPERATOR, DIRECT)


def bounced(direct: np.ndarray) -> np.ndarray:
    return np.einsum("cst,tn->scn", OPERATOR, direct)


def flat(side: int, height: float = 0.0, up: float = 1.0) -> SurfacePoints:
    x, y = np.meshgrid(*[np.arange(side) * 0.1] * 2)
    position = np.stack([x.ravel(), y.ravel(), np.full(side**2, height)], axis=1)
    return SurfacePoints(
        position, np.tile([0.0, 0.0, up], (side**2, 1)), 0 * position, np.zeros(side**2, int), 0 * position
    )


def together(*parts: SurfacePoints) -> SurfacePoints:
    return SurfacePoints(
        *(np.concatenate([getattr(part, name) for part in parts])
          for name in ("position", "normal", "albedo", "face", "barycentric"))
    )  # fmt: skip


def test_with_every_function_the_transfer_is_the_operator():
    size = SAMPLES // CLUSTERS
    found = ClusteredTransfer.fit(LIGHT, OWNER, bounced, size, size).indirect(DIRECT)
    np.testing.assert_allclose(found, CAUSED, rtol=1e-9)


def test_with_few_it_is_the_operator_between_projections():
    model = ClusteredTransfer.fit(LIGHT, OWNER, bounced, 2, 3)
    sent, received = (np.zeros((SAMPLES, SAMPLES)) for _ in range(2))
    for cluster in range(CLUSTERS):
        rows = np.flatnonzero(cluster == OWNER)
        for basis, out in ((model.sources, sent), (model.receivers, received)):
            np.testing.assert_allclose(basis[rows].T @ basis[rows], np.eye(basis.shape[1]), atol=1e-12)
            out[np.ix_(rows, rows)] = basis[rows] @ basis[rows].T
    wanted = np.stack([received @ OPERATOR[c] @ sent @ DIRECT[:, c] for c in range(CHANNELS)], axis=1)
    np.testing.assert_allclose(model.indirect(DIRECT), wanted, rtol=1e-9)
    assert np.linalg.norm(wanted - CAUSED) < 0.1 * np.linalg.norm(CAUSED)


def test_sixteen_bits_change_it_by_a_hundredth_of_a_percent_and_once_only():
    model = ClusteredTransfer.fit(LIGHT, OWNER, bounced, 4, 4)
    stored = model.quantised()
    off = np.abs(stored.indirect(DIRECT) - model.indirect(DIRECT)).max() / CAUSED.max()
    assert 0 < off < 1e-4
    np.testing.assert_array_equal(stored.quantised().sources, stored.sources)


def test_light_on_an_open_plane_falls_with_the_square_of_the_distance():
    points, directions = flat(5), hemisphere_directions(64)
    depth = np.full((len(points), 64), np.inf, np.float32)
    owner = np.zeros(len(points), int)
    seen = ClusteredVisibility.fit(depth, directions, owner, 3, 0.25)
    nothing = ClusteredTransfer(owner, np.zeros((25, 1)), np.zeros((25, 1)), np.zeros((3, 1, 1)))
    model = SampledLight(points, seen, nothing, reaches(points), np.zeros((25, 4, 2)))
    place = np.array([0.1, 0.3, 0.8])
    away = place - points.position
    squared = np.sum(away**2, axis=1)
    wanted = (0.8 / np.sqrt(squared) / (squared + 0.01**2))[:, None] * (2.0, 1.0, 0.5)
    lighting = Lighting((PointLight(place, (2.0, 1.0, 0.5)),))
    np.testing.assert_allclose(model.direct(lighting), wanted, rtol=1e-6)
    with pytest.raises(LightError, match="not directional"):
        model.direct(Lighting((DirectionalLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0)),)))


def test_a_splat_reaches_to_the_sixth_neighbour_of_its_own_side():
    """On a square grid that is one of the four diagonal ones, whatever lies behind the surface."""
    points = flat(7)
    inner = np.flatnonzero(np.all((points.position[:, :2] > 0.05) & (points.position[:, :2] < 0.55), axis=1))
    alone, backed = reaches(points), reaches(together(points, flat(7, -0.01, -1.0)))
    np.testing.assert_allclose(alone[inner], np.sqrt(0.02))
    np.testing.assert_allclose(backed[: len(points)], alone)
    np.testing.assert_allclose(reaches(points[np.array([0, 3])]), 0.3)


def test_bad_samples_are_refused():
    with pytest.raises(FitError, match="at least 1"):
        ClusteredTransfer.fit(LIGHT, OWNER, bounced, 0, 3)
    with pytest.raises(FitError, match="NaN"):
        ClusteredTransfer.fit(LIGHT * np.nan, OWNER, bounced, 2, 3)
