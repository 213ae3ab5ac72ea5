"""Directions, rotations and scipy's harmonics, the oracle."""

import numpy as np
import pytest
from scipy.special import sph_harm_y

from prt_bench.spherical import azimuths, bands


@pytest.fixture(scope="session")
def directions():
    """Unit vectors: both poles, the axes, close to the poles and anywhere."""
    rng = np.random.default_rng(0)
    scattered = rng.normal(size=(60, 3))
    near = rng.normal(size=(20, 3)) * [1e-3, 1e-3, 1.0]
    several = np.concatenate([np.eye(3), -np.eye(3), near, scattered])
    return several / np.linalg.norm(several, axis=1, keepdims=True)


@pytest.fixture(scope="session")
def rotations():
    """The identity, half turns about the axes, quarter turns (where Euler angles lock), tiny turns, and any."""
    rng = np.random.default_rng(1)
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    special = [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), quarter, quarter.T]
    tiny = np.linalg.qr(np.eye(3) + 1e-9 * rng.normal(size=(3, 3)))[0]
    anywhere = np.linalg.qr(rng.normal(size=(10, 3, 3)))[0]
    every = np.concatenate([special, [tiny * np.sign(np.diagonal(tiny))], anywhere])
    return every * np.sign(np.linalg.det(every))[:, None, None]


@pytest.fixture(scope="session")
def oracle():
    """Real harmonics of scipy's complex ones, whose phase (−1)ᵐ is taken out."""

    def harmonics(directions, order):
        x, y, z = directions.T
        polar, azimuth = np.arctan2(np.hypot(x, y), z)[:, None], np.arctan2(y, x)[:, None]
        m = azimuths(order)
        value = sph_harm_y(bands(order), np.abs(m), polar, azimuth) * (-1.0) ** np.abs(m)
        return np.where(m == 0, value.real, np.sqrt(2.0) * np.where(m < 0, value.imag, value.real))

    return harmonics
