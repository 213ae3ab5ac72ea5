"""A table in a room without ceiling or front: floor and walls of two triangles, soft shadows where there is no vertex.

Distant light falls in over the walls and through the open front, and the table's shadow lies in the middle of the floor.
Values kept at vertices alone cannot hold it; `room-fine` is the same surface in small triangles. The table's top has a
glossy lobe, which diffuse transfer leaves out.
"""

import numpy as np
import trimesh

from data_gen.geometry import Part, assemble, box, quad, rotation_about, solid
from prt_bench.scene import Camera, Glossy, Material, Scene

FLOOR, WALL, ACCENT, WOOD, CHAIR, VASE, BALL, TOP = range(8)
TABLE_HEIGHT = 0.62


def build() -> Scene:
    """Floor y = 0, x and z from −1 to 1 m; walls 1 m high behind, left and right. Their fronts face the room."""
    materials = (
        Material("floor", (0.62, 0.58, 0.52)),
        Material("wall", (0.7, 0.7, 0.68)),
        Material("accent", (0.2, 0.36, 0.55)),
        Material("wood", (0.48, 0.3, 0.16)),
        Material("chair", (0.6, 0.14, 0.1)),
        Material("vase", (0.75, 0.72, 0.66)),
        Material("ball", (0.25, 0.5, 0.2)),
        Material("top", (0.48, 0.3, 0.16), glossy=Glossy((0.3, 0.3, 0.3), 60.0)),
    )
    ball = solid(trimesh.creation.icosphere(subdivisions=2, radius=0.09), BALL)
    vase = solid(trimesh.creation.revolve(_VASE, sections=16), VASE).transformed(rotation_about(0, -90.0))
    parts = [
        quad([(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)], FLOOR),
        quad([(-1, 0, -1), (1, 0, -1), (1, 1, -1), (-1, 1, -1)], WALL),  # behind
        quad([(-1, 0, 1), (-1, 0, -1), (-1, 1, -1), (-1, 1, 1)], ACCENT),  # left
        quad([(1, 0, -1), (1, 0, 1), (1, 1, 1), (1, 1, -1)], WALL),  # right
        *_table(0.55, 0.36),
        *[part.transformed(rotation_about(1, 155.0), (0.3, 0.0, 0.55)) for part in _chair()],
        ball.transformed(np.eye(3), (0.16, TABLE_HEIGHT + 0.09, 0.02)),
        vase.transformed(np.eye(3), (-0.25, TABLE_HEIGHT, -0.08)),
    ]
    return Scene("room", assemble(parts), materials, Camera((0.75, 1.75, 3.1), (-0.02, 0.38, -0.1), fov_y=38.0))


_VASE = np.array([(0.0, 0.0), (0.07, 0.0), (0.1, 0.08), (0.09, 0.16), (0.045, 0.24), (0.06, 0.29), (0.0, 0.29)])
"""Radius and height of the vase's outline, from the middle of its foot to the middle of its lid."""


def _table(half_width: float, half_depth: float) -> list[Part]:
    """A top 4 cm thick on four legs."""
    leg, top = 0.035, 0.02
    height = 0.5 * TABLE_HEIGHT - top
    across, along = half_width - 2.0 * leg, half_depth - 2.0 * leg
    return [
        box((half_width, top, half_depth), TOP).transformed(np.eye(3), (0.0, TABLE_HEIGHT - top, 0.0)),
        *_legs(leg, height, across, along, WOOD),
    ]


def _chair() -> list[Part]:
    """A seat 0.36 m high with a back, looking at −z before it is turned."""
    return [
        box((0.17, 0.015, 0.17), CHAIR).transformed(np.eye(3), (0.0, 0.345, 0.0)),
        box((0.17, 0.17, 0.015), CHAIR).transformed(np.eye(3), (0.0, 0.53, -0.155)),
        *_legs(0.02, 0.165, 0.15, 0.15, CHAIR),
    ]


def _legs(half_side: float, half_height: float, across: float, along: float, material: int) -> list[Part]:
    """Four posts on the floor at (±across, ±along)."""
    post = box((half_side, half_height, half_side), material)
    return [post.transformed(np.eye(3), (x, half_height, z)) for x in (-across, across) for z in (-along, along)]
