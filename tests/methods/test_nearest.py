"""The lookup table of baked lightmaps."""

from types import SimpleNamespace

import numpy as np

import prt_bench as prt

RNG = np.random.default_rng(0)
LIGHT = SimpleNamespace(measured=RNG.uniform(0.1, 1, (12, 9, 1)), indirect=RNG.uniform(0.1, 1, (12, 30, 1)))


def test_training_lightings_are_recalled_at_any_intensity():
    model = prt.method("nearest").fit(LIGHT)
    for factor in (1.0, 1e-3, 50.0):
        found = model.reconstruct(model.transfer(factor * LIGHT.measured))
        np.testing.assert_allclose(found, factor * LIGHT.indirect, rtol=1e-12)


def test_a_lighting_that_misses_the_measurement_points_is_never_chosen():
    """Its light over ‖x‖ would be a million times too bright for a test lighting in its direction."""
    missed = SimpleNamespace(measured=LIGHT.measured.copy(), indirect=LIGHT.indirect)
    missed.measured[4] *= 1e-6
    model = prt.method("nearest").fit(missed)
    assert np.max(model.reconstruct(model.transfer(LIGHT.measured))) < 10 * np.max(LIGHT.indirect)
