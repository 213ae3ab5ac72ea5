"""An apartment of six furnished rooms joined by doors: light goes from room to room, and no room sees all others.

A basis for the whole scene has to hold what happens in every room; one for a part of it does not. 12 by 9 m, 2.7 m high; the
shell is one-sided and faces inward, inner walls are solid and end at floor and ceiling.
"""

import numpy as np
import trimesh

from data_gen.geometry import Part, assemble, box, quad, solid
from prt_bench.scene import Camera, Material, Scene

FLOOR, WALL, WARM, BLUE, GREEN, WOOD, CLOTH, STONE = range(8)
HALF = (6.0, 4.5)
HEIGHT, DOOR, OPENING = 2.7, 2.1, 0.95
THICKNESS = 0.12


def build() -> Scene:
    """Floor y = 0, x from −6 to 6 and z from −4.5 to 4.5 m: two rows of three rooms, with walls at x = ±2 and z = 0."""
    materials = (
        Material("floor", (0.5, 0.4, 0.3)),
        Material("wall", (0.75, 0.74, 0.71)),
        Material("warm", (0.7, 0.38, 0.22)),
        Material("blue", (0.25, 0.38, 0.62)),
        Material("green", (0.3, 0.52, 0.28)),
        Material("wood", (0.42, 0.27, 0.15)),
        Material("cloth", (0.6, 0.2, 0.18)),
        Material("stone", (0.6, 0.59, 0.57)),
    )
    parts = [*_shell(), *_inner_walls(), *_furniture()]
    return Scene("apartment", assemble(parts), materials, Camera((-5.6, 1.75, 4.1), (-3.4, 1.0, 1.2), fov_y=68.0))


def _shell() -> list[Part]:
    x, z, y = *HALF, HEIGHT
    return [
        quad([(-x, 0, z), (x, 0, z), (x, 0, -z), (-x, 0, -z)], FLOOR),
        quad([(-x, y, -z), (x, y, -z), (x, y, z), (-x, y, z)], WALL),
        quad([(-x, 0, -z), (x, 0, -z), (x, y, -z), (-x, y, -z)], WALL),
        quad([(x, 0, z), (-x, 0, z), (-x, y, z), (x, y, z)], WALL),
        quad([(-x, 0, z), (-x, 0, -z), (-x, y, -z), (-x, y, z)], WARM),
        quad([(x, 0, -z), (x, 0, z), (x, y, z), (x, y, -z)], BLUE),
    ]


def _inner_walls() -> list[Part]:
    """One wall along x with a door into each room of the other row but the middle, and two along z with a door each way."""
    half = 0.5 * THICKNESS
    along_x = _wall(0, 0.0, (-HALF[0], HALF[0]), (-3.2, 4.6), WALL)
    west = [*_wall(2, -2.0, (-HALF[1], -half), (-1.4,), GREEN), *_wall(2, -2.0, (half, HALF[1]), (3.0,), WALL)]
    east = [*_wall(2, 2.0, (-HALF[1], -half), (-3.1,), WALL), *_wall(2, 2.0, (half, HALF[1]), (1.3,), WARM)]
    return [*along_x, *west, *east]


def _wall(axis: int, at: float, ends: tuple[float, float], doors: tuple[float, ...], material: int) -> list[Part]:
    """A wall along an axis with openings centred at `doors`, each with a lintel above."""
    parts, start = [], ends[0]
    for door in doors:
        first, last = door - 0.5 * OPENING, door + 0.5 * OPENING
        parts.append(_slab(axis, at, (start, first), (0.0, HEIGHT), material))
        parts.append(_slab(axis, at, (first, last), (DOOR, HEIGHT), material))
        start = last
    return [*parts, _slab(axis, at, (start, ends[1]), (0.0, HEIGHT), material)]


def _slab(axis: int, at: float, along: tuple[float, float], up: tuple[float, float], material: int) -> Part:
    half, centre = np.full(3, 0.5 * THICKNESS), np.full(3, at)
    half[1], centre[1] = 0.5 * (up[1] - up[0]), 0.5 * (up[1] + up[0])
    half[axis], centre[axis] = 0.5 * (along[1] - along[0]), 0.5 * (along[1] + along[0])
    return box(tuple(half), material).transformed(np.eye(3), tuple(centre))


def _furniture() -> list[Part]:
    """Beds, tables, cupboards, shelves, and two round things; all stand on the floor."""
    blocks = [
        ((-4.6, 3.2), (1.0, 0.25, 0.8), CLOTH),  # bed
        ((-2.5, 1.2), (0.3, 1.0, 0.7), WOOD),  # cupboard
        ((0.2, 2.6), (0.8, 0.37, 0.5), WOOD),  # table
        ((-1.5, 0.45), (0.35, 0.45, 0.25), STONE),
        ((4.4, 3.7), (1.1, 0.3, 0.45), CLOTH),  # sofa
        ((4.2, 2.2), (0.5, 0.2, 0.35), WOOD),
        ((-4.4, -3.6), (1.2, 0.45, 0.35), STONE),  # kitchen
        ((-5.2, -1.2), (0.4, 0.9, 0.3), WOOD),
        ((0.0, -3.9), (1.2, 0.9, 0.25), WOOD),  # shelf
        ((4.9, -3.2), (0.8, 0.25, 1.0), CLOTH),
        ((2.5, -0.5), (0.3, 1.0, 0.3), WOOD),
    ]
    ball = solid(trimesh.creation.icosphere(subdivisions=2, radius=0.35), GREEN)
    column = solid(trimesh.creation.cylinder(radius=0.22, height=HEIGHT - 0.2, sections=24), STONE)
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return [
        *(box(half, kind).transformed(np.eye(3), (x, half[1], z)) for (x, z), half, kind in blocks),
        ball.transformed(np.eye(3), (-0.9, 0.35, -2.2)),
        column.transformed(upright, (0.8, 0.5 * HEIGHT - 0.1, -1.8)),
    ]
