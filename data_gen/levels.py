"""Levels of blocks as scenes: the mesh that a level stands for, to be baked, traced and compared like any other."""

import numpy as np

from data_gen.geometry import Part, assemble
from prt_bench.modular.cube import inward
from prt_bench.modular.level import Level
from prt_bench.scene import Camera, Material, Scene

EDGE = 3.0
"""Metres of a block's edge."""
NAMES = ("wall +x", "wall -x", "ceiling", "floor", "wall +z", "wall -z")


def scene_of(level: Level, albedo: tuple[tuple[float, float, float], ...] = ((0.7, 0.7, 0.7),) * 6) -> Scene:
    """The faces of a level's blocks, fronts inward, with an albedo for each of the six kinds of face.

    Block (i, j) is centred at (i, 0, j) · `EDGE`.
    """
    parts = []
    for block, face in level.surfaces():
        column, row = level.cells[block]
        normal = inward(np.array([face]))[0]
        u, v = np.eye(3)[(face // 2 + 1) % 3], np.eye(3)[(face // 2 + 2) % 3]
        corners = np.array([a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) - normal
        order = np.array([[0, 1, 2], [0, 2, 3]])
        if np.dot(np.cross(u, v), normal) < 0:
            order = order[:, ::-1]
        parts.append(Part(EDGE * (np.array([column, 0.0, row]) + 0.5 * corners), order, face))
    middle = EDGE * np.mean([(column, 0.0, row) for column, row in level.cells], axis=0)
    far = EDGE * (2.0 + np.ptp(np.array(level.cells), axis=0).max())
    x, z = float(middle[0]), float(middle[2])
    camera = Camera((x, float(far), z + 0.1 * EDGE), (x, 0.0, z))
    materials = tuple(Material(name, colour) for name, colour in zip(NAMES, albedo, strict=True))
    return Scene(f"level-{len(level.cells)}", assemble(parts), materials, camera)
