"""Tunnels of pipes as scenes: the mesh that a tunnel stands for, to be baked, traced and compared like any other."""

import numpy as np

from data_gen.geometry import Part, assemble
from prt_bench.modular.pipe import AXIS, RADIUS
from prt_bench.modular.tunnel import Tunnel
from prt_bench.points import SurfacePoints
from prt_bench.scene import Camera, Material, Scene

EDGE = 4.0
"""Metres of a cell's edge; a pipe is 2.4 m wide."""
AROUND = 48
"""Quads around a pipe, and along `ALONG`."""
ALONG = 20
FLOOR = 0.25
"""The share of what is around a pipe that is floor. Its edges lie between quads, and between samples where 8 divides `side`."""
_MARGIN = 0.06  # of a tile of the lightmap, on either side
Colour = tuple[float, float, float]


def scene_of(tunnel: Tunnel, walls: tuple[Colour, ...] = ((0.7, 0.7, 0.7),), floor: Colour | None = None) -> Scene:
    """The walls of a tunnel, fronts inward, the cell (0, 0) about the origin.

    Pieces have the colours `walls` by turns; where `floor` is given, the lowest part of all has that. Texture coordinates are
    an atlas, a rectangle for each piece.
    """
    count, materials = len(tunnel.pieces), [Material(f"wall {number}", colour) for number, colour in enumerate(walls)]
    if floor:
        materials.append(Material("floor", floor))
    parts = []
    for piece in range(count):
        wall = piece % len(walls)
        parts += _piece(tunnel, piece, wall, len(walls) if floor else wall)
    camera = Camera((-0.45 * EDGE, 0.05 * EDGE, 0.0), (0.5 * EDGE, 0.0, 0.0), fov_y=70.0)
    return Scene(f"tunnel-{count}", assemble(parts), tuple(materials), camera)


def _piece(tunnel: Tunnel, piece: int, wall: int, floor: int) -> list[Part]:
    """Walls and floor of one piece, with their place in the lightmap."""
    along, around = np.meshgrid(np.arange(ALONG + 1) / ALONG, np.arange(AROUND + 1) / AROUND, indexing="ij")
    position, _ = tunnel.place(piece, along.ravel(), around.ravel())
    corner = np.arange((ALONG + 1) * (AROUND + 1)).reshape(ALONG + 1, AROUND + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    columns = int(np.ceil(np.sqrt(len(tunnel.pieces))))
    inside = _MARGIN + (1.0 - 2.0 * _MARGIN) * np.stack([around.ravel(), along.ravel()], axis=1)
    uv = ((np.array([piece % columns, piece // columns]) + inside) / columns)[faces]
    # The seam is joined again: the last place around is the first.
    joined = (corner[:, :1] + np.arange(AROUND + 1) % AROUND).ravel()
    low = np.abs(around.ravel()[faces].mean(axis=1) - 0.75) < 0.5 * FLOOR
    return [
        Part(EDGE * position, joined[faces[rows]], material, uv[rows])
        for rows, material in ((~low, wall), (low, floor))
    ]


def tunnel_samples(
    tunnel: Tunnel, side: int, walls: tuple[Colour, ...] = ((1.0, 1.0, 1.0),), floor: Colour | None = None
) -> SurfacePoints:
    """The `side`² samples of every piece, where the scene of the tunnel has them, just within the facets of its mesh."""
    position, normal, _ = tunnel.points(side)
    colour = np.stack([np.broadcast_to(walls[at % len(walls)], position.shape[1:]) for at in range(len(position))])
    around = np.tile((np.arange(side) + 0.5) / side, side)
    if floor:
        colour[:, np.abs(around - 0.75) < 0.5 * FLOOR] = floor
    place, every = EDGE * position.reshape(-1, 3), normal.reshape(-1, 3)
    facet = RADIUS * (1.0 - np.cos(np.pi / AROUND)) + (AXIS + RADIUS) * (1.0 - np.cos(0.25 * np.pi / ALONG))
    place = place + EDGE * facet * every
    return SurfacePoints(place, every, colour.reshape(-1, 3), np.zeros(len(every), int), np.ones_like(every) / 3.0)
