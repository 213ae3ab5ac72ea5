"""Priors on direct light: what light might look like between the lightings of a dataset.

A prior is a set of columns, patterns of direct light on the surface that are independent of each other. Their covariance is
a sum of outer products, so that in a regression they stand beside the lightings as if they were some themselves.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.distance import cdist

from prt_bench.dataset import LightingDataset
from prt_bench.linalg import safe_norm
from prt_bench.points import SurfacePoints

Kind = Literal["cells", "surface"]


class Columns(NamedTuple):
    """Direct light of P patterns: `measured` [M, P] at the measurement points, `direct` [S, P] at the gather samples."""

    measured: Float[np.ndarray, "M P"]
    direct: Float[np.ndarray, "S P"]


def prior_columns(ds: LightingDataset, kind: Kind) -> Columns:
    """One pattern around each measurement point.

    "cells": constant on the samples that are nearest to the point and face its way. "surface": a Gaussian as wide as the
    spacing of the measurement points, normalised so that all patterns together light the surface evenly. Nearness is
    Euclidean in position and normal together; opposite normals count as four times the spacing, so that a pattern neither
    leaks through a thin wall nor around a corner.
    """
    points = ds.measurement_points
    spacing = float(np.sqrt(ds.transport.scene.mesh.areas.sum() / len(points)))

    def feature(of: SurfacePoints) -> Float[np.ndarray, "P 6"]:
        return np.hstack([of.position, 2.0 * spacing * of.normal]).astype(np.float32)

    centres = feature(points)

    def patterns(of: SurfacePoints) -> Float[np.ndarray, "P M"]:
        squared = cdist(feature(of), centres, "sqeuclidean").astype(np.float32)
        nearest = np.argmin(squared, axis=1)
        if kind == "cells":
            return np.eye(len(centres), dtype=np.float32)[nearest]
        squared -= squared[np.arange(len(squared)), nearest, None]  # no underflow far from every point
        weight = np.exp(-squared / (2.0 * spacing**2))
        return weight / weight.sum(axis=1, keepdims=True)

    at_dense = patterns(ds.dense_points)
    return Columns(at_dense[np.asarray(ds.groups)].mean(axis=1).astype(float), patterns(ds.transport.samples))


def mixed(
    lightings: tuple[Float[Array, "M n"], Float[Array, "B n"]],
    prior: tuple[Float[Array, "M P"], Float[Array, "B P"]],
    share: float | Float[Array, ""],
) -> tuple[Float[Array, "M n+P"], Float[Array, "B n+P"]]:
    """Inputs and targets of a regression whose covariance is (1 − share) of the lightings' and `share` of the prior's.

    Both covariances are scaled to the same trace at the measurement points.
    """
    factors = scale(1.0 - share, lightings[0]), scale(share, prior[0])
    x, targets = (
        jnp.concatenate([factor * columns for factor, columns in zip(factors, pair, strict=True)], axis=1)
        for pair in zip(lightings, prior, strict=True)
    )
    return x, targets


def scale(share: float | Array, columns: Float[Array, "M n"] | Float[np.ndarray, "M n"]) -> Float[Array, ""]:
    """The factor that gives the columns' outer products the trace `share`; 0 where all columns are black."""
    size = safe_norm(jnp.asarray(columns).ravel(), axis=0)[0]
    some = (size > 0) & (jnp.asarray(share) > 0)
    return jnp.where(some, jnp.sqrt(jnp.where(some, share, 1.0)) / jnp.where(some, size, 1.0), 0.0)
