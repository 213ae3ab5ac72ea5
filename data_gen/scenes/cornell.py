"""Cornell box: coloured interreflection between a red, a green and white walls and two white blocks.

The proportions are those of the box in Mitsuba's gallery, with side 2 m and the floor at y = 0. Walls are one-sided and
face inward, the front (+z) is open, and the blocks are closed, so the floor below them receives nothing.
Goral et al. 1984, "Modeling the Interaction of Light Between Diffuse Surfaces".
"""

from data_gen.geometry import assemble, box, quad, rotation_about
from prt_bench.scene import Camera, Material, Scene

WHITE, RED, GREEN = range(3)


def build() -> Scene:
    """The box, x and z from −1 to 1, y from 0 to 2."""
    materials = (
        Material("white", (0.725, 0.71, 0.68)),
        Material("red", (0.63, 0.065, 0.05)),
        Material("green", (0.14, 0.45, 0.091)),
    )
    parts = [
        quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], WHITE),  # floor
        quad([(-1, 2, -1), (1, 2, -1), (1, 2, 1), (-1, 2, 1)], WHITE),  # ceiling
        quad([(-1, 0, -1), (1, 0, -1), (1, 2, -1), (-1, 2, -1)], WHITE),  # back
        quad([(-1, 0, 1), (-1, 0, -1), (-1, 2, -1), (-1, 2, 1)], RED),  # left
        quad([(1, 0, -1), (1, 0, 1), (1, 2, 1), (1, 2, -1)], GREEN),  # right
        box((0.3, 0.3, 0.3), WHITE).transformed(rotation_about(1, -17.0), (0.335, 0.3, 0.38)),
        box((0.3, 0.61, 0.3), WHITE).transformed(rotation_about(1, 18.25), (-0.33, 0.61, -0.28)),
    ]
    return Scene("cornell", assemble(parts), materials, Camera((0.0, 1.0, 3.9), (0.0, 1.0, 0.0), fov_y=39.3))
