"""A statue of alabaster on a plinth: a thick translucent body with thin ears, which light from behind shines through.

The figure is Suzanne (CC0, `assets/SOURCES.md`) made one closed body: her eyes, which are shells of their own, are left out,
and smooth domes without pupils, as statues have them, close the sockets.
"""

import numpy as np
import trimesh
from jaxtyping import Float, Int

from data_gen import assets
from data_gen.geometry import assemble, box, quad, rotation_about, solid
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Scene

GROUND, PLINTH, STONE = range(3)
ALABASTER = Subsurface.of_albedo((0.998, 0.99, 0.97), (0.02, 0.02, 0.02), ior=1.5)
"""White stone with a warm depth: what passes an ear is pale yellow, what passes the skull is amber."""
_SCALE = 0.3
_TILT = -15.0  # degrees, by which the face looks up
_RINGS = 8  # of triangles in the dome of an eye
_BULGE = 0.3  # height of a dome over the radius of its socket
_PLINTH = (0.15, 0.11, 0.12)  # half-extents
_GAP = 0.002
"""Between bodies that stand on each other, in metres: enough to tell surfaces apart."""


def build() -> Scene:
    """Ground y = 0, 1.2 × 1.2 m; the figure is 0.56 m wide and looks to +z."""
    materials = (
        Material("ground", (0.35, 0.35, 0.37)),
        Material("plinth", (0.45, 0.42, 0.4)),
        Material("stone", (0.0, 0.0, 0.0), subsurface=ALABASTER),
    )
    stone = solid(figure(), STONE).transformed(_SCALE * rotation_about(0, _TILT))
    foot = 2.0 * _PLINTH[1] + 2.0 * _GAP - stone.vertices[:, 1].min()
    parts = [
        quad([(-0.6, 0, 0.6), (0.6, 0, 0.6), (0.6, 0, -0.6), (-0.6, 0, -0.6)], GROUND),
        box(_PLINTH, PLINTH).transformed(np.eye(3), (0.0, _PLINTH[1] + _GAP, 0.0)),
        stone.transformed(np.eye(3), (0.0, foot, 0.0)),
    ]
    camera = Camera((0.2, 1.0, 1.35), (0.0, 0.38, -0.02), fov_y=29.0)
    return Scene("statue", assemble(parts), materials, camera)


def figure() -> trimesh.Trimesh:
    """Suzanne's head without its eyes, closed, as the file has it: 1.86 wide."""
    source = trimesh.load_mesh(assets.SUZANNE, process=True)
    head = max(source.split(only_watertight=False), key=lambda shell: len(shell.faces))
    vertices, faces = np.asarray(head.vertices), np.asarray(head.faces)
    for rim in _rims(faces):
        rings, cap = _dome(vertices[rim], len(vertices), rim)
        vertices, faces = np.concatenate([vertices, rings]), np.concatenate([faces, cap])
    return trimesh.Trimesh(vertices, faces, process=False)


def _rims(faces: Int[np.ndarray, "F 3"]) -> list[Int[np.ndarray, " n"]]:
    """Loops of vertices around holes, in the direction in which the missing faces would run along them."""
    edges = np.concatenate([faces[:, (0, 1)], faces[:, (1, 2)], faces[:, (2, 0)]])
    there = set(map(tuple, edges.tolist()))
    following = {b: a for a, b in there if (b, a) not in there}
    rims = []
    while following:
        rim = [next(iter(sorted(following)))]
        while (after := following.pop(rim[-1])) != rim[0]:
            rim.append(after)
        rims.append(np.array(rim))
    return rims


def _dome(
    edge: Float[np.ndarray, "n 3"], first: int, rim: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    """Rings of vertices, numbered from `first`, that rise from a rim to its middle, and the faces between them."""
    count, middle = len(rim), edge.mean(axis=0)
    spokes = edge - middle
    normal = np.cross(spokes, np.roll(spokes, -1, axis=0)).sum(axis=0)
    normal *= _BULGE * np.linalg.norm(spokes, axis=1).mean() / np.linalg.norm(normal)
    share = 1.0 - np.arange(1, _RINGS)[:, None, None] / _RINGS
    rings = middle + share * spokes + np.cos(0.5 * np.pi * share) * normal
    vertices = np.concatenate([rings.reshape(-1, 3), middle[None] + normal])
    numbers = np.concatenate([rim[None], first + np.arange(count * (_RINGS - 1)).reshape(-1, count)])
    after = np.roll(numbers, -1, axis=1)
    low, high = (numbers[:-1], after[:-1]), (numbers[1:], after[1:])
    sides = [np.stack([low[0], low[1], high[1]], -1), np.stack([low[0], high[1], high[0]], -1)]
    tip = np.stack([numbers[-1], after[-1], np.full(count, first + len(vertices) - 1)], -1)
    return vertices, np.concatenate([*(side.reshape(-1, 3) for side in sides), tip])
