"""Every effect at once: a glossy floor, a translucent ring, a skin-like ball with hair, and diffuse walls and a box among them.

Light goes from each to the others: what leaves the wax tints the hair, hair shades the skin that it grows on, and the floor
mirrors all of it dimly. 300 strands are few enough for a bake of seconds.
"""

import numpy as np
import trimesh

from data_gen.geometry import assemble, box, quad, rotation_about, solid
from data_gen.scenes.bust import SKIN_MEDIUM
from data_gen.strands import Growth, grow
from prt_bench.hair import Hair, absorption_of
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Glossy, Material, Scene

FLOOR, WALL, WAX, SKIN, BOX, FIBRES = range(6)
STRANDS = 300
_LIFT = 0.002


def build() -> Scene:
    """Floor y = 0, 1.6 × 1.4 m, wall x = −0.8; the ball has a radius of 14 cm and strands of 9 cm, and floats."""
    black = (0.0, 0.0, 0.0)
    materials = (
        Material("floor", (0.35, 0.34, 0.32), glossy=Glossy((0.35, 0.35, 0.35), 6.0)),
        Material("wall", (0.6, 0.22, 0.15)),
        Material("wax", black, subsurface=Subsurface.of_albedo((0.97, 0.99, 0.96), (0.02,) * 3, 0.4, 1.4)),
        Material("skin", black, subsurface=SKIN_MEDIUM),
        Material("box", (0.2, 0.35, 0.6)),
        Material("hair", hair=Hair.of_roughness(absorption_of((0.6, 0.35, 0.18)), 0.3, 0.3)),
    )
    ring = solid(trimesh.creation.torus(0.17, 0.055, major_sections=36, minor_sections=14), WAX)
    ball = solid(trimesh.creation.icosphere(subdivisions=3, radius=0.14), SKIN)
    parts = [
        quad([(-0.8, 0, 0.7), (0.8, 0, 0.7), (0.8, 0, -0.7), (-0.8, 0, -0.7)], FLOOR),
        quad([(-0.8, 0, 0.7), (-0.8, 0, -0.7), (-0.8, 0.8, -0.7), (-0.8, 0.8, 0.7)], WALL),
        ring.transformed(rotation_about(1, 35.0), (0.42, 0.225 + _LIFT, 0.1)),
        ball.transformed(np.eye(3), (-0.2, 0.26, 0.1)),
        box((0.13, 0.2, 0.13), BOX).transformed(rotation_about(1, 20.0), (0.1, 0.2, -0.42)),
    ]
    bare = Scene("medley", assemble(parts), materials, Camera((0.75, 1.0, 1.9), (0.02, 0.18, 0.0), fov_y=33.0))
    growth = Growth(length=0.09, radius=8e-4, segments=4, spread=0.3, fall=0.5, curl=0.3)
    return grow(bare, SKIN, FIBRES, STRANDS, growth, seed=7)
