"""A head of hair on a neck and shoulders over the ground: 10,000 strands that shadow, tint and fill each other with light.

The strands grow, by a seed, on a scalp that covers the crown and the back of a head. `hairball` has many more of them.
"""

import numpy as np
import trimesh

from data_gen.geometry import assemble, quad, rotation_about, solid
from data_gen.strands import Growth, grow
from prt_bench.hair import Hair, absorption_of
from prt_bench.scene import Camera, Material, Scene

GROUND, SKIN, SCALP, FIBRES = range(4)
STRANDS = 10_000
_COLOUR = (0.42, 0.24, 0.1)


def build() -> Scene:
    """Ground y = 0, 2 × 2 m; the head's middle is 0.42 m above it. Strands are 14 cm long, and 0.3 mm thick: each
    stands for a lock of some ten hairs."""
    materials = (
        Material("ground", (0.5, 0.48, 0.45)),
        Material("skin", (0.62, 0.42, 0.33)),
        Material("scalp", (0.4, 0.28, 0.2)),
        Material("hair", hair=Hair.of_roughness(absorption_of(_COLOUR), 0.3, 0.3)),
    )
    upright = rotation_about(0, -90.0)
    bust = solid(trimesh.creation.revolve(_OUTLINE, sections=32), SKIN).transformed(upright)
    head = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    head.apply_scale((0.095, 0.125, 0.11))
    middle = np.asarray(head.triangles).mean(axis=1)
    # The hairline rises from the neck behind to the forehead in front, where z is largest.
    covered = middle[:, 1] > 0.03 + 0.55 * middle[:, 2]
    parts = [
        quad([(-1.0, 0, 1.0), (1.0, 0, 1.0), (1.0, 0, -1.0), (-1.0, 0, -1.0)], GROUND),
        bust,
    ]
    for faces, material in ((head.faces[~covered], SKIN), (head.faces[covered], SCALP)):
        part = trimesh.Trimesh(head.vertices, faces, process=False)
        part.remove_unreferenced_vertices()
        parts.append(solid(part, material).transformed(np.eye(3), (0.0, 0.42, 0.0)))
    camera = Camera((0.38, 0.95, 0.95), (0.0, 0.33, 0.0), fov_y=32.0)
    bare = Scene("hair", assemble(parts), materials, camera)
    growth = Growth(length=0.14, radius=1.5e-4, segments=5, spread=0.25, fall=2.6, curl=0.15)
    return grow(bare, SCALP, FIBRES, STRANDS, growth, seed=3)


_OUTLINE = np.array(
    [(0.0, 0.0), (0.19, 0.0), (0.2, 0.1), (0.15, 0.19), (0.07, 0.23), (0.055, 0.27), (0.055, 0.32), (0.0, 0.33)]
)
"""Radius and height of the bust's outline, from the middle of its foot to the neck within the head."""
