"""The cube by closed forms: form factors between squares, turns, maps of the disk, a prior that does not divide by its size."""

import numpy as np
import pytest

from prt_bench.errors import FitError
from prt_bench.modular.cube import (
    FACES,
    bilinear,
    cosine_rays,
    disk,
    inward,
    meet,
    one_bounce,
    place,
)
from prt_bench.modular.cube import square as to_square
from prt_bench.modular.modes import direct_light, enriched, present, reduced

SIDE = 8
OPPOSITE = 0.1998249  # form factor between opposite faces of a cube (Howell's catalogue, C-11)


def face_of(side):
    return np.repeat(np.arange(FACES), side * side)


def test_light_between_faces_is_that_of_the_closed_form():
    transport, face = one_bounce(16), face_of(16)
    between = np.array(
        [[transport[np.ix_(face == a, face == b)].sum(axis=1).mean() for b in range(FACES)] for a in range(FACES)]
    )
    wanted = np.full((FACES, FACES), (1.0 - OPPOSITE) / 4.0)
    for a in range(FACES):
        wanted[a, a], wanted[a, a ^ 1] = 0.0, OPPOSITE
    np.testing.assert_allclose(between, wanted, atol=1e-3)  # samples stand for cells


def test_one_bounce_loses_nothing_goes_both_ways_and_amplifies_nothing():
    transport = one_bounce(SIDE)
    np.testing.assert_allclose(transport.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(transport, transport.T, atol=1e-15)
    assert transport.min() >= 0
    assert np.linalg.norm(transport, 2) == pytest.approx(1.0, abs=1e-12)


def test_rays_meet_the_cube_where_they_point():
    random = np.random.default_rng(0)
    origin, direction = random.uniform(-0.49, 0.49, (500, 3)), random.normal(size=(500, 3))
    met = meet(origin, direction)
    found = place(met)
    assert np.abs(found).max() == pytest.approx(0.5)
    np.testing.assert_allclose(np.cross(found - origin, direction), 0.0, atol=1e-12)
    assert np.all(np.sum((found - origin) * direction, axis=1) > 0)
    assert np.all(np.sum(inward(met.face) * found, axis=1) < 0)
    columns, weights = bilinear(met, SIDE)
    assert np.all(columns // SIDE**2 == met.face[:, None])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)


def test_cosine_rays_have_their_moments():
    rays = cosine_rays(np.array([[0.0, 1.0, 0.0]]), 64)[0]
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    np.testing.assert_allclose(rays.mean(axis=0), [0.0, 2.0 / 3.0, 0.0], atol=2e-3)


def test_the_square_and_the_disk_are_maps_of_each_other():
    a, b = np.random.default_rng(0).uniform(0, 1, (2, 4000))
    a[:3], b[:3] = (0.5, 0.5, 0.25), (0.5, 0.75, 0.25)  # the middle, an axis, a diagonal
    x, y = disk(a, b)
    assert np.hypot(x, y).max() <= 1.0
    np.testing.assert_allclose(to_square(x, y), (a, b), atol=1e-12)
    assert np.mean(np.hypot(x, y) < 0.5) == pytest.approx(0.25, abs=0.03)  # areas in proportion


@pytest.mark.parametrize("missing", [(), (0,), (0, 1, 4, 5)])
def test_reduced_transfer_is_the_projected_one_and_has_no_large_entry(missing):
    """b = Uᵀ F P Pᵀ l, where Vᵀ S⁻¹ Pᵀ l has entries that grow with the prior."""
    modes = reduced(SIDE, missing, functions=24, prior=40, lights=40)
    here = present(SIDE, missing)
    transport = one_bounce(SIDE) * here[:, None] * here
    np.testing.assert_allclose(modes.basis.T @ modes.basis, np.eye(24), atol=1e-10)
    assert np.linalg.norm(modes.read, 2) <= 1.0 + 1e-9
    np.testing.assert_allclose(transport @ modes.implicit, modes.basis, atol=1e-9)
    light = direct_light(SIDE, missing, 40)
    wanted = transport @ light
    assert np.linalg.norm(modes.basis @ (modes.read @ light) - wanted) < 0.08 * np.linalg.norm(wanted)  # 24 functions
    np.testing.assert_allclose(modes.basis[~here], 0.0, atol=1e-12)


def test_enrichment_skips_what_is_dark_and_refuses_what_is_not_finite():
    part = np.random.default_rng(0).normal(size=(60, 4))
    alone, _ = enriched([part], 8)
    beside, values = enriched([np.zeros((60, 3)), part], 8)
    assert beside.shape == (60, 4)
    assert np.all(values > 0)
    np.testing.assert_allclose(alone @ (alone.T @ part), beside @ (beside.T @ part), atol=1e-12)
    with pytest.raises(FitError, match="no light"):
        enriched([np.zeros((60, 3))], 8)
    with pytest.raises(FitError, match="finite"):
        enriched([np.full((60, 3), np.nan)], 8)


def test_rays_about_slanted_normals_are_unit_and_cosine_distributed():
    """The second moment of directions with density cos / π about n is (1 + n nᵀ) / 4."""
    normal = np.random.default_rng(0).standard_normal((20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rays = cosine_rays(normal, 64)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=2), 1.0, rtol=1e-12)
    moment = np.einsum("nri,nrj->nij", rays, rays) / rays.shape[1]
    np.testing.assert_allclose(moment, 0.25 * (np.eye(3) + normal[:, :, None] * normal[:, None]), atol=1e-3)
