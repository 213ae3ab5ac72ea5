"""Levels of blocks as scenes: the mesh that a level stands for, to be baked, traced and compared like any other."""

import numpy as np
from jaxtyping import Float

from data_gen.geometry import Part, assemble
from prt_bench.modular.cube import FACES, inward
from prt_bench.modular.level import STEPS, Level
from prt_bench.points import SurfacePoints
from prt_bench.scene import Camera, Material, Scene

EDGE = 3.0
"""Metres of a block's edge."""
WALL = 0.03
"""Metres of a wall's thickness between two blocks: faces that coincided would hide each other from rays."""
Colours = tuple[tuple[float, float, float], ...]
"""An albedo for each of the six kinds of face."""
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])  # of a face, along its two axes
NAMES = ("wall +x", "wall -x", "ceiling", "floor", "wall +z", "wall -z")


def scene_of(
    level: Level, albedo: Colours = ((0.7, 0.7, 0.7),) * 6, bumps: Float[np.ndarray, "h w 3"] | None = None
) -> Scene:
    """The faces of a level's blocks, fronts inward.

    A block's cell · `EDGE` is its centre. A wall between two blocks takes half of its thickness from each.
    """
    parts, between = [], _between(level)
    for block, face in level.surfaces():
        normal = inward(np.array([face]))[0]
        u, v = np.eye(3)[(face // 2 + 1) % 3], np.eye(3)[(face // 2 + 2) % 3]
        corners = (2.0 * _CORNERS - 1.0) @ np.stack([u, v]) - normal
        order = np.array([[0, 1, 2], [0, 2, 3]])
        if np.dot(np.cross(u, v), normal) < 0:
            order = order[:, ::-1]
        inset = 0.5 * WALL * normal if (block, face) in between else 0.0
        uv = None if bumps is None else _CORNERS[order]
        parts.append(Part(EDGE * (np.array(level.cells[block]) + 0.5 * corners) + inset, order, face, uv))
    cells = np.array(level.cells)
    x, y, z = (EDGE * cells.mean(axis=0)).tolist()
    far = EDGE * (2.0 + np.ptp(cells[:, [0, 2]], axis=0).max() + 0.5 * np.ptp(cells[:, 1]))
    camera = Camera((x, y + float(far), z + 0.1 * EDGE), (x, y, z))
    materials = tuple(Material(name, colour, normal_image=bumps) for name, colour in zip(NAMES, albedo, strict=True))
    return Scene(f"level-{len(level.cells)}", assemble(parts), materials, camera)


def block_samples(level: Level, side: int, albedo: Colours = ((1.0, 1.0, 1.0),) * 6) -> SurfacePoints:
    """The `side`² samples of every face of every block, where the scene of the level has them, those of missing faces too."""
    position, normal = level.points(side)
    place = EDGE * position.reshape(len(position), FACES, -1, 3)
    normals = normal.reshape(FACES, -1, 3)
    for block, face in _between(level):
        place[block, face] += 0.5 * WALL * normals[face]
    place = place.reshape(-1, 3)
    every = np.broadcast_to(normal, position.shape).reshape(-1, 3)
    colour = np.tile(np.repeat(np.array(albedo), side * side, axis=0), (len(position), 1))
    return SurfacePoints(place, every, colour, np.zeros(len(every), int), np.ones_like(every) / 3.0)


def _between(level: Level) -> set[tuple[int, int]]:
    """(block, face) of the two faces of each wall between blocks."""
    index = {cell: at for at, cell in enumerate(level.cells)}
    found = set()
    for wall in level.walls:
        one, other = sorted(wall)
        face = STEPS.index(tuple(int(step) for step in np.subtract(other, one)))
        found |= {(index[one], face), (index[other], face ^ 1)}
    return found
