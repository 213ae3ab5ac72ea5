"""A wax candle, a jade ring and a soap ball beside a coloured wall: translucent bodies that light shines through.

Thin parts let light through, thick ones glow near their edges, and the wall and the ground receive what leaves them. The bodies
stand a little above the ground, which is one-sided: nothing but what gets in there lights them from below.
"""

import numpy as np
import trimesh

from data_gen.geometry import Part, assemble, quad, rotation_about, solid
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Scene

GROUND, WALL, WAX, JADE, SOAP = range(5)
_GAP = 0.002
"""How far above the ground the bodies stand, in metres."""


def build() -> Scene:
    """Ground y = 0, 1.6 × 1.4 m, and wall x = −0.8; the candle is 0.62 m high, and its wax lets light through 2 cm."""
    black = (0.0, 0.0, 0.0)
    wax = Subsurface.of_albedo((0.998, 0.993, 0.97), (0.02, 0.02, 0.02), anisotropy=0.5, ior=1.4)
    jade = Subsurface.of_albedo((0.95, 0.985, 0.96), (0.02, 0.02, 0.02), anisotropy=0.3, ior=1.5)
    soap = Subsurface.of_albedo((0.99, 0.985, 0.992), (0.05, 0.05, 0.05), anisotropy=0.6, ior=1.4)
    materials = (
        Material("ground", (0.55, 0.53, 0.5)),
        Material("wall", (0.25, 0.35, 0.6)),
        Material("wax", black, subsurface=wax),
        Material("jade", black, subsurface=jade),
        Material("soap", black, subsurface=soap),
    )
    candle = solid(trimesh.creation.revolve(_OUTLINE, sections=40), WAX).transformed(rotation_about(0, -90.0))
    ring = solid(trimesh.creation.torus(0.15, 0.045, major_sections=40, minor_sections=16), JADE)
    ball = solid(trimesh.creation.icosphere(subdivisions=3, radius=0.13), SOAP)
    parts: list[Part] = [
        quad([(-0.8, 0, 0.7), (0.8, 0, 0.7), (0.8, 0, -0.7), (-0.8, 0, -0.7)], GROUND),
        quad([(-0.8, 0, 0.7), (-0.8, 0, -0.7), (-0.8, 0.9, -0.7), (-0.8, 0.9, 0.7)], WALL),
        candle.transformed(np.eye(3), (-0.22, _GAP, -0.15)),
        ring.transformed(rotation_about(1, 25.0), (0.25, 0.195 + _GAP, 0.05)),
        ball.transformed(np.eye(3), (-0.05, 0.13 + _GAP, 0.36)),
    ]
    return Scene("candle", assemble(parts), materials, Camera((0.5, 1.2, 1.95), (-0.05, 0.2, 0.0), fov_y=33.0))


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
