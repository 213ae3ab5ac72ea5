"""A plant in a pot and blades of grass around it: thin two-sided leaves that shadow and tint each other.

Leaves and blades are bent strips, drawn by a seed; both of their sides reflect. `plants-fine` subdivides them.
"""

import numpy as np
import trimesh
from jaxtyping import Float

from data_gen.geometry import Part, assemble, quad, solid, with_both_sides
from prt_bench.scene import Camera, Material, Mesh, Scene

GROUND, POT, SOIL, LEAF, GRASS = range(5)
MATERIALS = (
    Material("ground", (0.5, 0.44, 0.36)),
    Material("pot", (0.6, 0.26, 0.15)),
    Material("soil", (0.16, 0.11, 0.08)),
    Material("leaf", (0.2, 0.46, 0.12), two_sided=True),
    Material("grass", (0.38, 0.52, 0.14), two_sided=True),
)
LEAVES, BLADES = 22, 20
ALONG = 12
"""Pieces that a leaf or blade is made of along its midrib."""
_POT = np.array([(0.0, 0.0), (0.2, 0.0), (0.27, 0.36), (0.3, 0.36), (0.3, 0.42), (0.26, 0.42), (0.25, 0.37)])
"""Radius and height of the pot's outline, from the middle of its foot over the rim down to the soil."""


def build() -> Scene:
    """Ground y = 0, 2.4 × 2 m; the pot is 0.42 m high, with its plant 1 m."""
    return scene("plants", sheets())


def scene(name: str, mesh: Mesh) -> Scene:
    """The scene around a mesh whose leaves have one side yet."""
    camera = Camera((0.7, 1.45, 3.0), (0.0, 0.5, 0.0), fov_y=36.0)
    return Scene(name, with_both_sides(mesh, MATERIALS), MATERIALS, camera)


def sheets() -> Mesh:
    """Ground, pot and soil, and one side of every leaf and blade."""
    rng = np.random.default_rng(5)
    pot = solid(trimesh.creation.revolve(_POT, sections=24), POT)
    soil = solid(trimesh.creation.revolve(np.array([(0.25, 0.37), (0.0, 0.39)]), sections=24), SOIL)
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    parts = [
        quad([(-1.2, 0, 1.0), (1.2, 0, 1.0), (1.2, 0, -1.0), (-1.2, 0, -1.0)], GROUND),
        pot.transformed(upright),
        soil.transformed(upright),
        *[_leaf(rng, index) for index in range(LEAVES)],
        *[_blade(rng) for _ in range(BLADES)],
    ]
    return assemble(parts)


def _leaf(rng: np.random.Generator, index: int) -> Part:
    """Out of the soil's middle and over the rim; later leaves stand steeper."""
    share = index / (LEAVES - 1)
    heading = index * np.pi * (3.0 - np.sqrt(5.0)) + rng.normal(0.0, 0.15)  # the golden angle
    length = rng.uniform(0.6, 0.85)
    lean, bend = np.radians(62.0 - 50.0 * share), np.radians(75.0 - 20.0 * share) * rng.uniform(0.8, 1.2)
    foot = 0.12 * np.sqrt(rng.random()) * np.array([np.cos(heading), 0.0, np.sin(heading)]) + (0.0, 0.375, 0.0)
    return _strip(foot, heading, length, 0.075 * rng.uniform(0.8, 1.2), lean, bend, 0.3, LEAF)


def _blade(rng: np.random.Generator) -> Part:
    """Out of the ground around the pot."""
    angle, distance = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.42, 0.9)
    foot = distance * np.array([1.15 * np.cos(angle), 0.0, np.sin(angle)])
    lean, bend = np.radians(rng.uniform(2.0, 20.0)), np.radians(rng.uniform(10.0, 70.0))
    length, heading = rng.uniform(0.18, 0.42), rng.uniform(0.0, 2.0 * np.pi)
    return _strip(foot, heading, length, rng.uniform(0.016, 0.028), lean, bend, 0.0, GRASS)


def _strip(
    foot: Float[np.ndarray, "3"],
    heading: float,
    length: float,
    half_width: float,
    lean: float,
    bend: float,
    trough: float,
    material: int,
) -> Part:
    """A pointed strip two pieces wide: it starts at `lean` radians from the vertical and has turned by `bend` at its tip.

    `trough` is by how much the edges rise over the midrib, relative to the width.
    """
    along = np.linspace(0.0, 1.0, ALONG + 1)
    middle = 0.5 * (along[1:] + along[:-1])
    angle = lean + bend * middle
    rise = np.concatenate([[0.0], np.cumsum(np.cos(angle))]) * length / ALONG
    reach = np.concatenate([[0.0], np.cumsum(np.sin(angle))]) * length / ALONG
    outward, across = (
        np.array([np.cos(heading), 0.0, np.sin(heading)]),
        np.array([-np.sin(heading), 0.0, np.cos(heading)]),
    )
    rib = foot + reach[:, None] * outward + rise[:, None] * np.array([0.0, 1.0, 0.0])
    turned = lean + bend * along
    upper = np.sin(turned)[:, None] * np.array([0.0, 1.0, 0.0]) - np.cos(turned)[:, None] * outward
    width = half_width * np.maximum(np.sin(np.pi * (0.12 + 0.88 * along)) ** 0.7, 0.0)[:-1, None]
    left, right = (rib[:-1] + width * (sign * across + trough * upper[:-1]) for sign in (-1.0, 1.0))
    vertices = np.concatenate([rib, left, right])
    row = np.arange(ALONG - 1)
    faces = []
    for side, flip in ((ALONG + 1, False), (2 * ALONG + 1, True)):
        lower, higher = np.stack([row, side + row, row + 1], 1), np.stack([side + row, side + row + 1, row + 1], 1)
        tip = np.array([[ALONG - 1, side + ALONG - 1, ALONG]])
        block = np.concatenate([lower, higher, tip])
        faces.append(block[:, ::-1] if flip else block)
    return Part(vertices, np.concatenate(faces), material)
