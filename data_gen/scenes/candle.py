"""A wax candle, a jade ring and a soap ball on a slab before a coloured wall: translucent bodies, and light behind them.

Thin parts let light through, thick ones glow near their edges, and the wall and the slab receive what leaves them. The bodies
stand a little in the slab, so that no light enters from below.
"""

import numpy as np
import trimesh

from data_gen.geometry import Part, assemble, box, quad, rotation_about, solid
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Scene

SLAB, WALL, WAX, JADE, SOAP = range(5)
_SUNK = 0.004
"""How deep the bodies stand in the slab, in metres."""


def build() -> Scene:
    """Slab 1.6 × 1.4 m, its top at y = 0, wall x = −0.8; the candle is 0.62 m high, and its wax lets light through 2 cm."""
    black = (0.0, 0.0, 0.0)
    wax = Subsurface.of_albedo((0.998, 0.993, 0.97), (0.02, 0.02, 0.02), anisotropy=0.5, ior=1.4)
    jade = Subsurface.of_albedo((0.95, 0.985, 0.96), (0.02, 0.02, 0.02), anisotropy=0.3, ior=1.5)
    soap = Subsurface.of_albedo((0.99, 0.985, 0.992), (0.05, 0.05, 0.05), anisotropy=0.6, ior=1.4)
    materials = (
        Material("slab", (0.55, 0.53, 0.5)),
        Material("wall", (0.25, 0.35, 0.6)),
        Material("wax", black, subsurface=wax),
        Material("jade", black, subsurface=jade),
        Material("soap", black, subsurface=soap),
    )
    candle = solid(trimesh.creation.revolve(_OUTLINE, sections=40), WAX).transformed(rotation_about(0, -90.0))
    ring = solid(trimesh.creation.torus(0.15, 0.045, major_sections=40, minor_sections=16), JADE)
    ball = solid(trimesh.creation.icosphere(subdivisions=3, radius=0.13), SOAP)
    parts: list[Part] = [
        box((0.8, 0.05, 0.7), SLAB).transformed(np.eye(3), (0.0, -0.05, 0.0)),
        quad([(-0.8, 0, 0.7), (-0.8, 0, -0.7), (-0.8, 0.9, -0.7), (-0.8, 0.9, 0.7)], WALL),
        candle.transformed(np.eye(3), (-0.22, -_SUNK, -0.15)),
        ring.transformed(rotation_about(1, 25.0), (0.25, 0.195 - _SUNK, 0.05)),
        ball.transformed(np.eye(3), (-0.05, 0.13 - _SUNK, 0.36)),
    ]
    return Scene("candle", assemble(parts), materials, Camera((0.5, 0.75, 2.1), (-0.05, 0.24, 0.0), fov_y=33.0))


_OUTLINE = np.array(
    [
        (0.0, 0.0),
        (0.16, 0.0),
        (0.15, 0.12),
        (0.15, 0.5),
        (0.155, 0.58),
        (0.14, 0.62),
        (0.11, 0.6),
        (0.08, 0.56),
        (0.0, 0.55),
    ]
)
"""Radius and height of the candle's outline, from the middle of its foot to the hollow that it burnt."""
