"""Two perpendicular unit squares that share an edge: one bounce of light has a closed form.

A directional light along (0, −1, −1) reaches both plates unshadowed and lights each evenly, so the light a plate sends
the other is its radiosity times the view factor of a rectangle from a point.
"""

import numpy as np
from jaxtyping import Float

from data_gen.geometry import assemble, quad
from prt_bench.scene import Camera, Material, Scene

ALBEDO = 0.5
FLOOR, WALL = range(2)


def build() -> Scene:
    """The floor is y = 0 facing up, the wall z = 0 facing +z; x, y and z run from 0 to 1 m."""
    materials = (Material("floor", (ALBEDO, ALBEDO, ALBEDO)), Material("wall", (ALBEDO, ALBEDO, ALBEDO)))
    parts = [
        quad([(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)], FLOOR),
        quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], WALL),
    ]
    return Scene("two-plates", assemble(parts), materials, Camera((0.5, 0.9, 3.0), (0.5, 0.4, 0.3), fov_y=35.0))


def view_factor(position: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
    """Share of the cosine-weighted hemisphere that the other plate fills, for points on either plate.

    One bounce from an evenly lit plate is E = ρ · E_dir(other plate) · view_factor. With h the distance from the shared
    edge, and the other plate of depth 1 split at the point's x into widths a = x and a = 1 − x:

        F = Σ_a [atan(a / h) − h / √(1 + h²) · atan(a / √(1 + h²))] / 2π

    (Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-4: element to a perpendicular rectangle.)
    """
    x = np.asarray(position)[:, 0]
    h = np.maximum(position[:, 1], position[:, 2])
    far = np.sqrt(1.0 + h**2)
    left, right = (np.arctan2(a, h) - h / far * np.arctan(a / far) for a in (x, 1.0 - x))
    return (left + right) / (2.0 * np.pi)
