"""Strands in a ball, without anything else or over a ground, as the tests of hair share them."""

import numpy as np

from data_gen.geometry import assemble, quad
from data_gen.strands import with_strands
from prt_bench.hair import Hair
from prt_bench.scene import Camera, Material, Mesh, Scene
from prt_bench.strands import Strands

WHITE = (0.0, 0.0, 0.0)
GROUND, FIBRES = range(2)


def tuft(hair: Hair, strands: int = 200, scale: float = 1.0, ground: bool = False, seed: int = 0) -> Scene:
    """Straight strands, 0.6 m long and 3 cm thick, through a ball of radius 0.5 m, everything `scale` times as large."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(strands, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = rng.normal(size=(strands, 3))
    middle *= (0.5 * rng.random(strands) ** (1 / 3) / np.linalg.norm(middle, axis=1))[:, None]
    along = np.linspace(-0.3, 0.3, 4)
    nodes = scale * (middle[:, None] + along[:, None] * direction[:, None]).reshape(-1, 3)
    corners = scale * np.array([(-1.5, -0.9, 1.5), (1.5, -0.9, 1.5), (1.5, -0.9, -1.5), (-1.5, -0.9, -1.5)])
    mesh = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0, int))
    if ground:
        mesh = assemble([quad(corners, GROUND)])
    camera = Camera((0.0, 0.5 * scale, 3.0 * scale), (0.0, 0.0, 0.0))
    bare = Scene("tuft", mesh, (Material("ground", (0.6, 0.6, 0.6)), Material("hair", hair=hair)), camera)
    starts = 4 * np.arange(strands + 1)
    return with_strands(bare, Strands(nodes, starts, np.full(strands, 0.015 * scale), np.full(strands, FIBRES)))
