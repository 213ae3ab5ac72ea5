"""A mannequin's bust with translucent skin and a head of hair: skin that light shines through, and strands that grow out of it.

Head, neck and shoulders are one closed body of revolution, narrower from side to side than a circle; 700 strands of fair hair
grow on the crown and the back of the head. They cover `hair`'s scalp more thinly, so that the scene bakes in seconds.
"""

import numpy as np
import trimesh

from data_gen.geometry import Part, assemble, quad, rotation_about, solid
from data_gen.strands import Growth, grow, with_strands
from prt_bench.hair import Hair, absorption_of
from prt_bench.medium import Subsurface
from prt_bench.scene import Camera, Material, Scene

GROUND, WALL, SKIN, FIBRES = range(4)
STRANDS = 700
SKIN_MEDIUM = Subsurface.of_albedo((0.995, 0.97, 0.93), (0.012, 0.012, 0.012), anisotropy=0.6, ior=1.4)
"""Like skin: red light goes farther than blue; so much of it that a head is no statue of marble."""
_LIFT = 0.002


def build() -> Scene:
    """Ground y = 0, 1.8 × 1.1 m, and a wall behind; the bust is 0.58 m high, and strands are 11 cm long."""
    materials = (
        Material("ground", (0.5, 0.48, 0.45)),
        Material("wall", (0.3, 0.4, 0.5)),
        Material("skin", (0.0, 0.0, 0.0), subsurface=SKIN_MEDIUM),
        Material("hair", hair=Hair.of_roughness(absorption_of((0.8, 0.55, 0.3)), 0.3, 0.3)),
    )
    made = trimesh.creation.revolve(outline(), sections=36)
    made.apply_scale((1.0, 0.85, 1.0))
    body = solid(made, SKIN).transformed(rotation_about(0, -90.0), (0.0, _LIFT, 0.0))
    ground = quad([(-0.9, 0, 0.6), (0.9, 0, 0.6), (0.9, 0, -0.5), (-0.9, 0, -0.5)], GROUND)
    wall = quad([(-0.9, 0, -0.5), (0.9, 0, -0.5), (0.9, 1.0, -0.5), (-0.9, 1.0, -0.5)], WALL)
    camera = Camera((0.45, 0.62, 1.3), (0.0, 0.3, 0.0), fov_y=30.0)
    bare = Scene("bust", assemble([ground, wall, body]), materials, camera)
    # Hair grows on a part of the skin: the hairline rises from the neck behind to the forehead, where z is largest.
    middle = body.vertices[body.faces].mean(axis=1)
    covered = middle[:, 1] > 0.42 + 0.55 * middle[:, 2]
    parts = [Part(body.vertices, body.faces[covered], SKIN), Part(body.vertices, body.faces[~covered], GROUND)]
    growth = Growth(length=0.11, radius=1e-3, segments=6, spread=0.2, fall=2.9, curl=0.12)
    grown = grow(Scene("bust", assemble(parts), materials, camera), SKIN, FIBRES, STRANDS, growth, seed=5)
    assert grown.strands is not None
    return with_strands(bare, grown.strands)


def outline() -> np.ndarray:
    """Radius and height, from the middle of the foot over shoulders, neck and jaw to the crown."""
    head = np.linspace(-0.85, 0.5 * np.pi, 14)
    skull = np.stack([0.105 * np.cos(head), 0.45 + 0.13 * np.sin(head)], axis=1)
    skull[-1, 0] = 0.0
    below = [
        (0.0, 0.0),
        (0.2, 0.0),
        (0.225, 0.05),
        (0.22, 0.1),
        (0.19, 0.15),
        (0.13, 0.19),
        (0.075, 0.215),
        (0.058, 0.25),
        (0.056, 0.31),
    ]
    return np.concatenate([below, skull])
