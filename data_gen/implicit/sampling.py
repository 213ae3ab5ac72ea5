"""Points on a zero set, uniform by area: where random lines cross it.

The crossings of lines that are uniform in direction and offset are spread evenly over any surface (Crofton), so nothing is
thinned or weighed, and curvature, folds and creases need no care. Lines come from a scrambled Sobol sequence.
"""

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from prt_bench.errors import SceneError
from prt_bench.implicit.scene import ImplicitScene
from prt_bench.implicit.tracing import crossings

_LINES = 4096
_EMPTY = 4
"""Batches of lines without any crossing after which a scene counts as empty."""


def surface_points(scene: ImplicitScene, count: int, seed: int = 0) -> Float[np.ndarray, "P 3"]:
    """`count` points of the surface inside the scene's box, in metres, on the zero set to rounding.

    Inner walls that no line of sight reaches count as surface. The same seed gives the same points. Raises `SceneError`
    for a scene whose surface is not found.
    """
    if count < 1:
        raise SceneError(f"{count} points of '{scene.name}' were asked for, but at least one is needed")
    sequence = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(seed))
    found: list[np.ndarray] = []
    batches = 0
    while sum(map(len, found)) < count:
        if batches == _EMPTY and not sum(map(len, found)):
            raise SceneError(
                f"no line crosses the surface of '{scene.name}'; check that its parts lie in its box and are not empty"
            )
        found.append(crossings(scene, *_lines(scene, sequence.random(_LINES))))
        batches += 1
    return np.concatenate(found)[:count]


def area(scene: ImplicitScene, lines: int = 1 << 14, seed: int = 0) -> float:
    """Estimate of the surface's area in m²: half of the lines' measure, 4π · π R² / 2π, per line, times all crossings."""
    sequence = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(seed))
    met = len(crossings(scene, *_lines(scene, sequence.random(lines))))
    return 2.0 * np.pi * (0.5 * scene.extent) ** 2 * met / lines


def _lines(scene: ImplicitScene, u: Float[np.ndarray, "n 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Lines uniform over the ball around the box: a direction on the sphere, an offset in the disc across it."""
    z, turn = 2.0 * u[:, 0] - 1.0, 2.0 * np.pi * u[:, 1]
    ring = np.sqrt(1.0 - z * z)
    direction = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    side = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(z)], axis=1)
    other = np.cross(direction, side)
    radius, angle = 0.5 * scene.extent * np.sqrt(u[:, 2]), 2.0 * np.pi * u[:, 3]
    middle = scene.bounds.mean(axis=0) - scene.extent * direction
    across = radius[:, None] * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other)
    return middle + across, direction
