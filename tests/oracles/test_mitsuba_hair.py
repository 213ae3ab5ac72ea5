"""The fibre's scattering function against mitsuba's hair BSDF, at single places across a fibre."""

import numpy as np
import pytest

from prt_bench.hair import Hair, Inclination, scattering
from tests.oracles.mitsuba_oracle import unavailable

COUNT = 400


def by_mitsuba(longitudinal: float, azimuthal: float, ior: float, absorption: tuple[float, ...]) -> tuple:
    """Directions and places, and mitsuba's values of f cos there. Its fibres lie along y, seen along z."""
    import drjit as dr
    import mitsuba as mi

    bsdf = mi.load_dict(
        {
            "type": "hair",
            "longitudinal_roughness": longitudinal,
            "azimuthal_roughness": azimuthal,
            "int_ior": ior,
            "scale_tilt": 2.0,
            "sigma_a": {"type": "rgb", "value": list(absorption)},
        }
    )
    rng = np.random.default_rng(1)
    out, into = (_unit(rng.normal(size=(COUNT, 3))) for _ in range(2))
    out[:, 2] = np.abs(out[:, 2])  # as curves show it: the place across follows from the direction
    h = -out[:, 0] / np.hypot(out[:, 0], out[:, 2])
    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi = mi.Vector3f(*(mi.Float(column) for column in out.T))
    towards = mi.Vector3f(*(mi.Float(column) for column in into.T))
    value = np.array(bsdf.eval(mi.BSDFContext(), si, towards)).reshape(3, COUNT).T
    return out, into, h, value


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("longitudinal", "azimuthal", "ior", "absorption"),
    [(0.3, 0.3, 1.55, (0.2, 0.35, 0.7)), (0.15, 0.5, 1.4, (0.0, 0.01, 2.0)), (0.7, 0.2, 1.8, (0.05, 0.0, 0.3))],
)
def test_scattering_is_that_of_mitsuba(longitudinal, azimuthal, ior, absorption) -> None:
    if reason := unavailable():
        pytest.skip(reason)
    out, into, h, theirs = by_mitsuba(longitudinal, azimuthal, ior, absorption)
    hair = Hair.of_roughness(absorption, longitudinal, azimuthal, ior, np.radians(2.0))
    azimuth = np.arctan2(into[:, 2], into[:, 0]) - np.arctan2(out[:, 2], out[:, 0])
    ours = scattering(hair, Inclination.of(out[:, 1]), Inclination.of(into[:, 1]), azimuth, h)
    np.testing.assert_allclose(ours, theirs, rtol=1e-2, atol=1e-3 * theirs.max())
    assert np.abs(ours - theirs).sum() < 3e-3 * theirs.sum()  # its Bessel function is a polynomial in float32
